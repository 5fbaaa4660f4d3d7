"use strict";
// Maps that zoom together, and two of them over one another behind a bar that one drags.

function heatmap(map, scales, more = {}) {
  return {type: "heatmap", x0: map.x0, dx: map.step, y0: map.y0, dy: map.step, z: rowsOf(map.z), zmin: map.low,
    zmax: map.high, colorscale: scales[map.scale], colorbar: {title: {text: map.unit, side: "right"}, thickness: 14,
    outlinewidth: 0}, hovertemplate: `%{x:.1f}, %{y:.1f}<br>${map.hover}: %{z:.3f}<extra></extra>`, hoverongaps: false,
    ...more};
}

function mapLayout(frame, map, more = {}) {
  const width = map.z.shape[1] * map.step, height = map.z.shape[0] * map.step;
  const x = [map.x0 - map.step / 2, map.x0 - map.step / 2 + width], y = [map.y0 - map.step / 2, map.y0 - map.step / 2 + height];
  return layoutOf({plot_bgcolor: "#d1d1d1", dragmode: "pan",
    xaxis: axis(frame.east, {range: x, tickformat: "d", constrain: "domain", showgrid: false, nticks: 6}),
    yaxis: axis(frame.north, {range: y, tickformat: "d", scaleanchor: "x", constrain: "domain", showgrid: false, nticks: 8}),
    ...more});
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
  const holder = document.getElementById("maps");
  if (!holder || !data.maps) return;
  const places = [];
  for (const map of data.maps) {
    const place = document.createElement("div");
    place.className = "plot map";
    holder.append(place);
    await Plotly.newPlot(place, [heatmap(map, data.scales)],
      mapLayout(data.frame, map, {title: heading(map.name), margin: {l: 70, r: 10, t: 36, b: 48}}), zooming);
    places.push(place);
  }
  linked(places);
});

views.push(async data => {
  const holder = document.getElementById("swipe");
  if (!holder || !data.maps) return;
  const margin = {l: 78, r: 96, t: 14, b: 52};
  const [under, over] = ["under", "over"].map(name => holder.querySelector(`.${name}`));
  const bar = holder.querySelector(".bar"), grip = holder.querySelector(".grip");
  const names = [holder.querySelector(".name.first"), holder.querySelector(".name.second")];
  let share = 0.5;
  const draw = (place, map, side) => Plotly.react(place, [heatmap(map, data.scales, {colorbar: {title: {text: map.unit,
    side: "right"}, thickness: 14, outlinewidth: 0, x: 1.01}, showscale: side === "right"})],
    mapLayout(data.frame, map, {margin, paper_bgcolor: side === "right" ? "#fff" : "rgba(0,0,0,0)"}), zooming);
  // The left map is clipped at the bar, which also lets the mouse through to the right one beyond it.
  const clip = () => {
    const full = under._fullLayout;
    if (!full) return;
    const [from, to] = [full._size.l, full.width - full._size.r], at = from + share * (to - from);
    over.style.clipPath = `inset(0 ${full.width - at}px 0 0)`;
    const top = full._size.t, height = full.height - full._size.t - full._size.b;
    Object.assign(bar.style, {left: `${at - 1}px`, top: `${top}px`, height: `${height}px`});
    Object.assign(grip.style, {left: `${at}px`, top: `${top + height / 2}px`});
    Object.assign(names[0].style, {left: `${from + 8}px`, top: `${top + 8}px`});
    Object.assign(names[1].style, {right: `${full._size.r + 8}px`, top: `${top + 8}px`});
  };
  const redraw = async () => {
    const [a, b] = ["left", "right"].map(name => data.maps[Number(control(name).value)]);
    names[0].textContent = a.name;
    names[1].textContent = b.name;
    const range = under._fullLayout && [under._fullLayout.xaxis.range.slice(), under._fullLayout.yaxis.range.slice()];
    await draw(under, b, "right");
    await draw(over, a, "left");
    if (range) await Promise.all([under, over].map(place =>
      Plotly.relayout(place, {"xaxis.range": range[0], "yaxis.range": range[1]})));
    clip();
  };
  await redraw();
  linked([under, over]);
  under.on("plotly_afterplot", clip);
  onControl("left", redraw);
  onControl("right", redraw);
  const move = event => {
    const box = holder.getBoundingClientRect(), size = under._fullLayout._size;
    share = Math.min(1, Math.max(0, (event.clientX - box.left - size.l) / size.w));
    clip();
  };
  grip.addEventListener("pointerdown", event => {
    grip.setPointerCapture(event.pointerId);
    grip.addEventListener("pointermove", move);
  });
  for (const end of ["pointerup", "pointercancel"]) grip.addEventListener(end, () => grip.removeEventListener("pointermove", move));
});
