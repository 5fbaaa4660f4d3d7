"use strict";
// Maps that zoom together, and two of them over one another behind a bar that one drags.

function heatmap(map, scales, more = {}) {
  return {type: "heatmap", x0: map.x0, dx: map.step, y0: map.y0, dy: map.step, z: rowsOf(map.z), zmin: map.low,
    zmax: map.high, colorscale: scales[map.scale], colorbar: {title: {text: map.unit, side: "right"}, thickness: 14,
    outlinewidth: 0, x: 1.01}, hovertemplate: `%{x:.1f}, %{y:.1f}<br>${map.hover}: %{z:.3f}<extra></extra>`, hoverongaps: false,
    ...more};
}

function mapLayout(frame, map, more = {}) {
  const width = map.z.shape[1] * map.step, height = map.z.shape[0] * map.step;
  const x = [map.x0 - map.step / 2, map.x0 - map.step / 2 + width], y = [map.y0 - map.step / 2, map.y0 - map.step / 2 + height];
  return layoutOf({plot_bgcolor: "#d1d1d1", dragmode: "pan",
    xaxis: axis(frame.east, {range: x, tickformat: "d", constrain: "domain", showgrid: false, nticks: 6, automargin: false}),
    yaxis: axis(frame.north, {range: y, tickformat: "d", scaleanchor: "x", constrain: "domain", showgrid: false, nticks: 8, automargin: false}),
    ...more});
}

const mapMargin = {l: 84, r: 92, t: 42, b: 52, autoexpand: false};

// Gives the room of a map the height that its shape asks for.
function fitted(place, map) {
  const shape = map.z.shape[0] / map.z.shape[1], inside = place.clientWidth - mapMargin.l - mapMargin.r;
  place.style.height = `${Math.round(Math.min(640, Math.max(260, inside * shape + mapMargin.t + mapMargin.b)))}px`;
}

async function drawMap(place, map, data) {
  fitted(place, map);
  return Plotly.newPlot(place, [heatmap(map, data.scales)], mapLayout(data.frame, map, {title: heading(map.name),
    margin: mapMargin}), zooming);
}

// Lets maps follow one another's zoom.
function linked(places) {
  let busy = false;
  for (const place of places) place.on("plotly_relayout", async () => {
    if (busy) return;
    busy = true;
    const {xaxis, yaxis} = place._fullLayout;
    const update = {"xaxis.range": xaxis.range.slice(), "yaxis.range": yaxis.range.slice()};
    await Promise.all(places.filter(other => other !== place).map(other => Plotly.relayout(other, update)));
    busy = false;
  });
}

const zooming = {...config, scrollZoom: true};


views.push(async data => {
  const holder = document.getElementById("swipe");
  if (!holder || !data.maps) return;
  // The maps beside: their rooms stand in the page already, so that each has its final width.
  const beside = Array.from(document.querySelectorAll("[data-map]"));
  for (const place of beside) await drawMap(place, data.maps[Number(place.dataset.map)], data);
  fitted(holder, data.maps[0]);
  const [under, over] = ["under", "over"].map(name => holder.querySelector(`.${name}`));
  const bar = holder.querySelector(".bar"), grip = holder.querySelector(".grip");
  const names = [holder.querySelector(".name.first"), holder.querySelector(".name.second")];
  let share = 0.5;
  // The map on the right carries the axes and both colour bars, one above the other where they differ.
  const drawRight = (map, other) => {
    const same = ["unit", "low", "high"].every(key => map[key] === other[key]), traces = [heatmap(map, data.scales)];
    if (!same) {
      const half = (one, y) => ({...one, colorbar: {...one.colorbar, len: 0.48, y, title: {...one.colorbar.title,
        font: {size: 11}}}});
      traces[0] = half(traces[0], 0.24);
      const hidden = {x0: map.x0, dx: map.step, y0: map.y0, dy: map.step, z: [[0]], opacity: 0, hoverinfo: "skip"};
      traces.push(half({...heatmap(other, data.scales), ...hidden}, 0.76));
    }
    return Plotly.react(under, traces, mapLayout(data.frame, map, {margin: mapMargin}), zooming);
  };
  const drawLeft = map => {
    const layout = mapLayout(data.frame, map, {margin: mapMargin, paper_bgcolor: "rgba(0,0,0,0)"});
    for (const one of [layout.xaxis, layout.yaxis]) Object.assign(one, {showticklabels: false, title: {text: ""}, ticks: ""});
    return Plotly.react(over, [heatmap(map, data.scales, {showscale: false})], layout, zooming);
  };
  // The left map is clipped at the bar, which also lets the mouse through to the right one beyond it.
  const clip = () => {
    const full = under._fullLayout;
    if (!full) return;
    const from = full.xaxis._offset, to = from + full.xaxis._length, at = from + share * (to - from);
    over.style.clipPath = `inset(0 ${full.width - at}px 0 0)`;
    const top = full.yaxis._offset, height = full.yaxis._length;
    Object.assign(bar.style, {left: `${at - 1}px`, top: `${top}px`, height: `${height}px`});
    Object.assign(grip.style, {left: `${at}px`, top: `${top + height / 2}px`});
    Object.assign(names[0].style, {left: `${from + 8}px`, top: `${top + 8}px`});
    Object.assign(names[1].style, {right: `${full.width - to + 8}px`, top: `${top + 8}px`});
  };
  const redraw = async () => {
    const [a, b] = ["left", "right"].map(name => data.maps[Number(control(name).value)]);
    names[0].textContent = a.name;
    names[1].textContent = b.name;
    const range = under._fullLayout && [under._fullLayout.xaxis.range.slice(), under._fullLayout.yaxis.range.slice()];
    await drawRight(b, a);
    await drawLeft(a);
    if (range) await Promise.all([under, over].map(place =>
      Plotly.relayout(place, {"xaxis.range": range[0], "yaxis.range": range[1]})));
    clip();
  };
  await redraw();
  linked([under, over, ...beside]);
  under.on("plotly_afterplot", clip);
  onControl("left", redraw);
  onControl("right", redraw);
  const move = event => {
    const box = holder.getBoundingClientRect(), {_offset, _length} = under._fullLayout.xaxis;
    share = Math.min(1, Math.max(0, (event.clientX - box.left - _offset) / _length));
    clip();
  };
  grip.addEventListener("pointerdown", event => {
    grip.setPointerCapture(event.pointerId);
    grip.addEventListener("pointermove", move);
  });
  for (const end of ["pointerup", "pointercancel"]) grip.addEventListener(end, () => grip.removeEventListener("pointermove", move));
});
