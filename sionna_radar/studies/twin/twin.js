"use strict";
// A recording beside its simulation: the mean echo of both, and the difference of each row in its own deviation.

views.push(async data => {
  const echo = data.echo, place = document.getElementById("profile");
  if (!echo || !place) return;
  const line = (name, y, color) => ({type: "scatter", mode: "lines", name, x: echo.offset_m, y, line: {color, width: 1.8}});
  await Plotly.newPlot(place, [line("measured", echo.measured_db, BLUE), line("simulated", echo.simulated_db, ORANGE)],
    layoutOf({showlegend: true, xaxis: axis("Range from the expected one (m)"), yaxis: axis("Mean power (dB)")}), config);
});

views.push(async data => {
  const scores = data.scores, place = document.getElementById("scores");
  if (!scores || !place) return;
  // A label for each bar: plotly leaves some out where there is little room.
  place.style.height = `${90 + 24 * scores.name.length}px`;
  const colours = scores.differs.map(differs => differs ? RED : BLUE);
  await Plotly.newPlot(place, [{type: "bar", orientation: "h", y: scores.name, x: scores.value, marker: {color: colours}}],
    layoutOf({xaxis: axis("Difference over its standard deviation between two that are alike"),
      yaxis: axis("", {autorange: "reversed", automargin: true, tickmode: "linear", dtick: 1})}), config);
});
