"use strict";
// A calibration: correlations of the errors, and residuals of the echoes as a histogram and on a map.

views.push(async data => {
  const found = data.correlation, place = document.getElementById("correlation");
  if (!found || !place) return;
  await Plotly.newPlot(place, [{type: "heatmap", x: found.name, y: found.name, z: found.value, zmin: -1, zmax: 1,
    colorscale: "RdBu", texttemplate: "%{z:.2f}"}],
    layoutOf({xaxis: axis(""), yaxis: axis("", {autorange: "reversed", automargin: true})}), config);
});

views.push(async data => {
  const found = data.histogram, place = document.getElementById("histogram");
  if (!found || !place) return;
  const line = (name, color) => ({type: "scatter", mode: "lines", line: {shape: "hvh", color, width: 1.8}, name,
    x: found.residual_m, y: found[name]});
  await Plotly.newPlot(place, [line("before", ORANGE), line("after", BLUE)],
    layoutOf({showlegend: true, xaxis: axis("Range minus predicted range (m)"), yaxis: axis("Echoes")}), config);
});

views.push(async data => {
  const found = data.map, place = document.getElementById("residual-map");
  if (!found || !place) return;
  await Plotly.newPlot(place, [{type: "heatmap", x: found.east_m, y: found.north_m, z: found.mean_m,
    zmin: -found.limit_m, zmax: found.limit_m, colorscale: "RdBu", colorbar: {title: {text: "m"}}}],
    layoutOf({xaxis: axis("East (m)"), yaxis: axis("North (m)", {scaleanchor: "x"})}), config);
});
