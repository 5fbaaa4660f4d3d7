"use strict";
// The fused map, its uncertainty, its sources and the contradictions, which zoom together.

views.push(async data => {
  const places = Array.from(document.querySelectorAll("[data-map]"));
  for (const place of places) await drawMap(place, data.maps[Number(place.dataset.map)], data);
  linked(places);
});
