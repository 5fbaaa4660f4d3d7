"use strict";
// Several results: maps without a bar between them, and profiles along a line that a slider moves.

views.push(async data => {
  if (!data.maps || document.getElementById("swipe")) return;
  const places = [];
  for (const place of document.querySelectorAll("[data-map]")) {
    await drawMap(place, data.maps[Number(place.dataset.map)], data);
    places.push(place);
  }
  if (data.linked) linked(places);
});

views.push(async data => {
  const profiles = data.profiles, place = document.getElementById("profile");
  if (!profiles || !place) return;
  const below = document.getElementById("profile-error"), colours = [BLUE, ORANGE, GREEN, PURPLE, SKY, RED];
  const heights = profiles.height.map(rowsOf), errors = profiles.error.map(rowsOf);
  const lines = rows => rows.map((_, i) => ({type: "scatter", mode: "lines", x: profiles.x, y: [], name: profiles.names[i],
    line: {color: colours[i % 6], width: 1.6, dash: i < 6 ? "solid" : "dash"}}));
  const layout = (title, label) => layoutOf({title: heading(title), showlegend: true, ...legendBelow,
    xaxis: axis(data.frame.east, {tickformat: "d"}), yaxis: axis(label)});
  await Plotly.newPlot(place, lines(heights), layout("DEMs along the line", data.frame.height), config);
  await Plotly.newPlot(below, lines(errors), layout("Errors along the line", "DEM minus truth (m)"), config);
  const show = line => {
    Plotly.restyle(place, {y: heights.map(rows => Array.from(rows[line]))});
    Plotly.restyle(below, {y: errors.map(rows => Array.from(rows[line]))});
    for (const out of document.querySelectorAll('[data-shows="line"]'))
      out.textContent = `${data.frame.north.replace(" (m)", "")} ${profiles.y[line].toFixed(1)} m`;
  };
  onControl("line", show);
  show(Number(control("line").value));
});
