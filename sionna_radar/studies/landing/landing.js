"use strict";
// The map of probabilities, with the numbered sites on it.

views.push(async data => {
  const place = document.getElementById("landing");
  await drawMap(place, data.map, data);
  await Plotly.addTraces(place, {type: "scatter", mode: "markers+text", x: data.sites.map(s => s[0]), y: data.sites.map(s => s[1]),
    text: data.sites.map((_, i) => `${i + 1}`), textposition: "top right", hoverinfo: "text", showlegend: false,
    marker: {symbol: "circle-open", size: 12, color: "#000", line: {width: 2}}});
});
