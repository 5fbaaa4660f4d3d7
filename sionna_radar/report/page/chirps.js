"use strict";
// The chirp browser, and the histogram of errors.

views.push(async data => {
  const chirps = data.chirps, time = document.getElementById("beat"), range = document.getElementById("spectrum");
  if (!chirps || !time) return;
  const beats = chirps.beat.map(part => rowsOf(part)), powers = rowsOf(chirps.power), limits = rowsOf(chirps.threshold);
  const row_of = Array.from(chirps.row);
  const highest = chirps.top_db + 6, lowest = Math.max(chirps.floor_db, chirps.top_db - 110);
  await Plotly.newPlot(time, beats.map((_, k) => ({type: "scatter", mode: "lines", x: chirps.time_ms, y: [], name:
    beats.length > 1 ? ["in phase", "quadrature"][k] : "beat signal", line: {color: [BLUE, ORANGE][k], width: 1}})),
    layoutOf({title: heading("Beat signal"), showlegend: beats.length > 1, ...(beats.length > 1 ? legendBelow : {}),
    xaxis: axis("Time in the chirp (ms)"), yaxis: axis(chirps.beat_label)}), config);
  await Plotly.newPlot(range, [
    {type: "scatter", mode: "lines", name: "spectrum", x: chirps.range_m, y: [], line: {color: BLUE, width: 1.2}},
    {type: "scatter", mode: "lines", name: "CFAR threshold", x: chirps.range_m, y: [],
      line: {color: ORANGE, width: 1.8, dash: "dash"}},
    {type: "scatter", mode: "markers", name: "detections", x: [], y: [], marker: {symbol: "triangle-down", size: 12,
      color: RED, line: {color: "#000", width: 1}}, hovertemplate: "%{x:.2f} m, %{y:.1f} dB<extra>detection</extra>"},
  ], layoutOf({title: heading("Range spectrum"), ...legendBelow, xaxis: axis("Range, not corrected for Doppler (m)"),
    yaxis: axis(chirps.power_label, {range: [lowest, highest]})}), config);
  const show = row => {
    let k = 0;  // the nearest pulse whose chirp is here
    row_of.forEach((other, i) => { if (Math.abs(other - row) < Math.abs(row_of[k] - row)) k = i; });
    const found = [];
    for (let i = 0; i < chirps.echo_row.length; i++)
      if (chirps.echo_row[i] === k) found.push([chirps.echo_range_m[i], chirps.echo_db[i]]);
    beats.forEach((part, i) => Plotly.restyle(time, {y: [Array.from(part[k], v => v * chirps.beat_scale[k])]}, [i]));
    Plotly.restyle(range, {y: [powers[k], limits[k], found.map(e => e[1])],
      x: [chirps.range_m, chirps.range_m, found.map(e => e[0])]}, [0, 1, 2]);
    const listed = found.slice(0, 4).map(e => `${e[0].toFixed(2)} m`).join(", ") || "none";
    for (const out of document.querySelectorAll('[data-shows="pulse-chirp"]')) out.textContent =
      `pulse ${chirps.pulse[k]}, detections: ${listed}${found.length > 4 ? ", ..." : ""}`;
  };
  chosen.listeners.push(show);
});

views.push(async data => {
  const place = document.getElementById("histogram");
  if (!place || !data.histogram) return;
  const {edges, series} = data.histogram, colours = [BLUE, ORANGE, GREEN, PURPLE, SKY, RED];
  const middles = edges.slice(0, -1).map((edge, i) => (edge + edges[i + 1]) / 2);
  const bars = series.length === 1;
  await Plotly.newPlot(place, series.map((one, i) => bars ?
    {type: "bar", x: middles, y: one.share, name: one.name, marker: {color: BLUE}, width: edges[1] - edges[0],
      hovertemplate: "%{x:.3f} m: %{y:.2f} %<extra></extra>"} :
    {type: "scatter", mode: "lines", line: {shape: "hvh", color: colours[i % 6], width: 2}, x: middles, y: one.share,
      name: one.name, hovertemplate: "%{x:.3f} m: %{y:.2f} %<extra></extra>"}),
    layoutOf({title: heading("Errors of the DEM"), showlegend: !bars, bargap: 0, xaxis: axis("DEM minus truth (m)"),
      yaxis: axis(data.histogram.heavy ? "Share of cells (%), logarithmic" : "Share of cells (%)",
      data.histogram.heavy ? {type: "log", dtick: 1, exponentformat: "none"} : {}), legend: {x: 1, xanchor: "right", y: 1},
      shapes: [{type: "line", x0: 0, x1: 0, yref: "paper", y0: 0, y1: 1, line: {color: "#5b6b7a", width: 1, dash: "dot"}}]}), config);
});

views.push(async data => {
  const place = document.getElementById("within");
  if (!place || !data.histogram) return;
  const {percent, series} = data.histogram, colours = [BLUE, ORANGE, GREEN, PURPLE, SKY, RED];
  const title = one => one.marks.map(([share, value]) => `LE${Math.floor(share)} ${value.toFixed(3)} m`).join(", ");
  await Plotly.newPlot(place, series.flatMap((one, i) => one.below.length ? [
    {type: "scatter", mode: "lines", x: one.below, y: percent, name: one.name, line: {color: colours[i % 6], width: 2},
      hovertemplate: "%{y} % within %{x:.3f} m<extra></extra>"},
    {type: "scatter", mode: "markers", x: one.marks.map(m => m[1]), y: one.marks.map(m => m[0]), showlegend: false,
      marker: {color: colours[i % 6], size: 8}, hovertemplate: "%{y} % within %{x:.3f} m<extra></extra>"}] : []),
    layoutOf({title: heading(series.length > 1 || !series[0].below.length ? "Share of cells within an error" :
      title(series[0])), showlegend: series.length > 1, legend: {x: 1,
      xanchor: "right", y: 0.05}, xaxis: axis("|DEM minus truth| (m)", {rangemode: "tozero"}),
      yaxis: axis("Share of cells (%)", {range: [0, 103]})}), config);
});
