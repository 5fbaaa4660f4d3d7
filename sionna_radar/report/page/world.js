"use strict";
// The view in three dimensions. Plots count in local metres, which keeps WebGL's 32-bit numbers exact; ticks show the
// coordinates of the map.

views.push(async data => {
  const world = data.world, place = document.getElementById("world");
  if (!world || !place) return;
  const frame = data.frame, scales = data.scales;
  const traces = [], number = {};
  const add = (name, trace) => { number[name] = traces.length; traces.push(trace); };
  const along = (first, step, count) => Float64Array.from({length: count}, (_, i) => first + i * step);
  const surface = (from, more) => ({type: "surface", x: from.x ?? along(from.x0, from.step, from.z.shape[1]),
    y: from.y ?? along(from.y0, from.step, from.z.shape[0]), z: rowsOf(from.z), name: from.name, showlegend: false,
    lighting: {ambient: 0.62, diffuse: 0.75, specular: 0.04, roughness: 0.95, fresnel: 0.05},
    lightposition: {x: -4000, y: 6000, z: 9000}, contours: {x: {highlight: false}, y: {highlight: false},
    z: {highlight: false}}, ...more});

  // ------------------------------------------------------------------------------------------------ ground
  const shift = (values, by) => values.map(row => Float64Array.from(row, value => value + by));
  const bar = title => ({title: {text: title, side: "right"}, thickness: 14, len: 0.72, x: 1.0, outlinewidth: 0});
  const painted = (shape, k) => {
    const paint = world.paints[k];
    const values = paint.z ? rowsOf(paint.z) : shift(rowsOf(world.shapes[shape].z), frame.origin[2]);
    return {surfacecolor: values, cmin: paint.low, cmax: paint.high, colorscale: scales[paint.scale],
      colorbar: bar(paint.name), hovertemplate: `${paint.name}: %{surfacecolor:.2f}<extra></extra>`};
  };
  if (world.around) add("around", surface(world.around, {colorscale: [[0, "#b9c1c9"], [1, "#d8dde2"]], showscale: false,
    hoverinfo: "skip"}));
  if (world.solids) {
    const {vertices, faces} = world.solids;
    add("solids", {type: "mesh3d", x: columnOf(vertices, 0), y: columnOf(vertices, 1), z: columnOf(vertices, 2),
      i: columnOf(faces, 0), j: columnOf(faces, 1), k: columnOf(faces, 2), color: "#c8b9a6", flatshading: true,
      lighting: {ambient: 0.55, diffuse: 0.8, specular: 0.05, facenormalsepsilon: 0, vertexnormalsepsilon: 0},
      lightposition: {x: -4000, y: 6000, z: 9000}, hoverinfo: "skip"});
  }
  add("ground", surface(world.shapes[0], painted(0, 0)));

  // ------------------------------------------------------------------------------------------------ lines and points
  const line = (places, more) => ({type: "scatter3d", mode: "lines", x: columnOf(places, 0), y: columnOf(places, 1),
    z: columnOf(places, 2), hoverinfo: "skip", ...more});
  if (world.rim) add("rim", line(world.rim, {line: {color: "#1b2733", width: 3, dash: "dash"}}));
  if (world.footprints) add("footprints", line(world.footprints, {line: {color: ORANGE, width: 3}}));
  if (world.hits) add("hits", {type: "scatter3d", mode: "markers", x: columnOf(world.hits, 0), y: columnOf(world.hits, 1),
    z: columnOf(world.hits, 2), hoverinfo: "skip", marker: {size: 1.8, color: "#fff", opacity: 0.8}});
  if (world.points) {
    const {position, pulse} = world.points;
    add("points", {type: "scatter3d", mode: "markers", x: columnOf(position, 0), y: columnOf(position, 1),
      z: columnOf(position, 2), customdata: pulse, marker: {size: 2, color: "#111", opacity: 0.75},
      hovertemplate: "echo of pulse %{customdata}<extra></extra>"});
  }
  if (world.thin) add("thin", line(world.thin, {line: {color: "#7a3b00", width: 3}}));
  if (world.reported) add("reported", {type: "scatter3d", mode: "markers", x: columnOf(world.reported, 0),
    y: columnOf(world.reported, 1), z: columnOf(world.reported, 2), marker: {size: 6, color: ORANGE, symbol: "diamond-open",
    line: {color: ORANGE, width: 2}}, hovertemplate: "reported obstacle<extra></extra>"});
  const {position, time_s} = world.track;
  add("track", line(position, {line: {color: "#000", width: 5}, hoverinfo: "text",
    text: Array.from(time_s, t => `${t.toFixed(2)} s`), hovertemplate: "flight, %{text}<extra></extra>"}));
  const empty = {type: "scatter3d", x: [null], y: [null], z: [null], hoverinfo: "skip"};
  const gains = world.beams ? rowsOf(world.beams.gain_db) : [];
  const weakest = Math.min(...gains.flatMap(row => Array.from(row)));
  const gainScale = [[0, "#fdd49e"], [0.5, "#fc8d59"], [1, "#b30000"]];
  add("rays", {...empty, mode: "lines", line: {width: 2, color: [0], colorscale: gainScale, cmin: Math.max(weakest, -30),
    cmax: 0, showscale: world.beams?.outline > 0, colorbar: {orientation: "h", x: 0.01, xanchor: "left", len: 0.22, y: 0.01, yanchor: "bottom",
    thickness: 9, outlinewidth: 0, title: {text: "Two-way gain of a ray (dB)", side: "top", font: {size: 11}},
    tickfont: {size: 11}}}});
  add("outline", {...empty, mode: "lines", line: {width: 5, color: RED}});
  add("axis", {...empty, mode: "lines", line: {width: 4, color: RED}});
  add("echoes", {...empty, mode: "markers", marker: {size: 6, color: RED, symbol: "diamond",
    line: {color: "#000", width: 1}}});

  // ------------------------------------------------------------------------------------------------ axes
  const spans = [0, 1, 2].map(k => world.bounds[1][k] - world.bounds[0][k]);
  const ticks = k => {
    const low = world.bounds[0][k] + frame.origin[k], span = Math.max(spans[k], 1e-6), rough = span / 5;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map(m => m * power).find(s => s >= rough);
    const values = [];
    for (let t = Math.ceil(low / step) * step; t <= low + span; t += step) values.push(t);
    const digits = Math.max(0, -Math.floor(Math.log10(step)));
    return {tickmode: "array", tickvals: values.map(t => t - frame.origin[k]), ticktext: values.map(t => t.toFixed(digits))};
  };
  const sceneAxis = (title, k) => ({title: {text: title, font: {size: 12}}, ...ticks(k), range: [world.bounds[0][k],
    world.bounds[1][k]], gridcolor: "#d5dce2", backgroundcolor: "#f5f7f9", showbackground: true, zeroline: false,
    showspikes: false, tickfont: {size: 11}});
  const ratio = up => {
    const size = Math.max(spans[0], spans[1], 1.5 * spans[2] * up);
    return {x: spans[0] / size * 1.5, y: spans[1] / size * 1.5, z: Math.max(spans[2] / size * 1.5 * up, 0.02)};
  };
  // Farther off and aimed higher the taller the box is; farther off where it is as wide as long.
  const tall = Math.min(ratio(1).z, 1.2);
  const back = 1.1 + 0.25 * tall + 0.3 * Math.min(spans[0], spans[1]) / Math.max(spans[0], spans[1]);
  const far = spans[1] > spans[0] ? {x: 1.2, y: -0.85, z: 0.72} : {x: -0.6, y: -1.25, z: 0.74};
  await Plotly.newPlot(place, traces, layoutOf({margin: {l: 0, r: 0, t: 0, b: 0}, showlegend: false, uirevision: "kept",
    scene: {xaxis: sceneAxis(frame.east, 0), yaxis: sceneAxis(frame.north, 1), zaxis: sceneAxis(frame.height, 2),
    aspectmode: "manual", aspectratio: ratio(1), camera: {eye: {x: far.x * back, y: far.y * back, z: far.z * back},
    center: {x: 0, y: 0, z: -0.24 + 0.2 * tall}}, dragmode: "turntable"}}),
  config);

  // ------------------------------------------------------------------------------------------------ controls
  const repaint = () => {
    const shape = Number(control("shape")?.value ?? 0), paint = painted(shape, Number(control("paint")?.value ?? 0));
    Plotly.restyle(place, {z: [rowsOf(world.shapes[shape].z)], surfacecolor: [paint.surfacecolor], cmin: paint.cmin,
      cmax: paint.cmax, colorscale: [paint.colorscale], "colorbar.title.text": paint.colorbar.title.text,
      hovertemplate: paint.hovertemplate}, [number.ground]);
  };
  onControl("paint", repaint);
  onControl("shape", repaint);
  onControl("upright", k => Plotly.relayout(place, {"scene.aspectratio": ratio([1, 2, 4][k])}));
  const toggles = {points: ["points"], track: ["track"], beam: ["rays", "outline", "axis", "echoes"], around: ["around"],
    footprints: ["footprints"], solids: ["solids"], rim: ["rim"], hits: ["hits"]};
  for (const [name, members] of Object.entries(toggles))
    onControl(name, on => Plotly.restyle(place, {visible: on}, members.filter(m => m in number).map(m => number[m])));

  // ------------------------------------------------------------------------------------------------ beam
  const beams = world.beams;
  if (!beams) return;
  const turns = rowsOf(beams.turn), origins = rowsOf(beams.position), fans = rowsOf(beams.directions);
  const distances = rowsOf(beams.distance);
  const showBeam = row => {
    const turn = turns[row], origin = origins[row], fan = fans[beams.fan[row]], gain = gains[beams.fan[row]];
    const end = (ray, share = 1) => [0, 1, 2].map(i => origin[i] + share * distances[row][ray] *
      (turn[3 * i] * fan[3 * ray] + turn[3 * i + 1] * fan[3 * ray + 1] + turn[3 * i + 2] * fan[3 * ray + 2]));
    const met = ray => !Number.isNaN(distances[row][ray]);
    const rays = {x: [], y: [], z: [], c: []};
    for (let ray = beams.outline + 1; ray < distances[row].length; ray++) {
      if (!met(ray)) continue;
      const tip = end(ray);
      for (const [from, to] of [["x", 0], ["y", 1], ["z", 2]]) rays[from].push(origin[to], tip[to], null);
      rays.c.push(gain[ray], gain[ray], gain[ray]);
    }
    // Drawn a little above the ground, which would hide half of it.
    const ring = [];
    for (let ray = 1; ray <= beams.outline; ray++) ring.push(met(ray) ? end(ray, 0.996) : [null, null, null]);
    if (ring.length) ring.push(ring[0]);
    const tip = met(0) ? end(0) : null;
    const pulse = beams.pulse[row], found = [];
    if (world.echoes) for (let i = 0; i < world.echoes.pulse.length; i++)
      if (world.echoes.pulse[i] === pulse) found.push([0, 1, 2].map(k => world.echoes.position[3 * i + k]));
    const part = (places, k) => places.length ? places.map(p => p[k]) : [null];
    const one = {x: [rays.x, part(ring, 0), tip ? [origin[0], tip[0]] : [null], part(found, 0)],
      y: [rays.y, part(ring, 1), tip ? [origin[1], tip[1]] : [null], part(found, 1)],
      z: [rays.z, part(ring, 2), tip ? [origin[2], tip[2]] : [null], part(found, 2)]};
    // All in one: each call draws the whole scene again.
    Plotly.restyle(place, {...one, "line.color": [rays.c, RED, RED, RED]},
      [number.rays, number.outline, number.axis, number.echoes]);
    const range = met(0) ? `${distances[row][0].toFixed(2)} m to the ground` : "meets nothing in reach";
    for (const out of document.querySelectorAll('[data-shows="pulse-world"]')) out.textContent =
      `pulse ${pulse}, ${beams.time_s[row].toFixed(2)} s, scan ${beams.scan_deg[row].toFixed(1)}°, ${range}`;
  };
  chosen.listeners.push(showBeam);
  place.on("plotly_click", event => {
    const pulse = event.points[0]?.customdata;
    if (typeof pulse !== "number") return;
    let best = 0;
    beams.pulse.forEach((p, row) => { if (Math.abs(p - pulse) < Math.abs(beams.pulse[best] - pulse)) best = row; });
    chosen.set(best);
  });
});
