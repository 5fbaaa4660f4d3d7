"use strict";
// Unpacks the numbers of the page (see scene_data.py) and plotly.js, then starts the views that the other scripts add.

const views = [];
const config = {responsive: true, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d", "toImage"]};
const font = {family: getComputedStyle(document.body).fontFamily, size: 13, color: "#1b2733"};
const BLUE = "#0072b2", RED = "#d55e00", ORANGE = "#e69f00", GREEN = "#009e73", PURPLE = "#cc79a7", SKY = "#56b4e9";

async function unpacked(id) {
  const word = atob(document.getElementById(id).textContent);
  const bytes = Uint8Array.from(word, letter => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

// Replaces each place of an array in a document by the array, with its shape.
function withArrays(node, content, first) {
  if (node === null || typeof node !== "object") return node;
  if ("at" in node && "type" in node && "shape" in node) {
    const kind = {u2: Uint16Array, i4: Int32Array, f4: Float32Array}[node.type];
    const count = node.shape.reduce((all, side) => all * side, 1);
    const raw = new kind(content, first + node.at, count);
    let values = raw;
    if ("step" in node) {
      values = new Float64Array(count);
      for (let i = 0; i < count; i++) values[i] = raw[i] === 65535 ? NaN : node.zero + node.step * raw[i];
    }
    values.shape = node.shape;
    return values;
  }
  for (const key of Object.keys(node)) node[key] = withArrays(node[key], content, first);
  return node;
}

// The rows of an array of two or more dimensions, as views of it.
function rowsOf(array) {
  const [count, ...rest] = array.shape, width = rest.reduce((all, side) => all * side, 1);
  return Array.from({length: count}, (_, i) => {
    const row = array.subarray(i * width, (i + 1) * width);
    row.shape = rest;
    return row;
  });
}

const columnOf = (array, k) => {
  const width = array.shape[1];
  return Float64Array.from({length: array.shape[0]}, (_, i) => array[i * width + k]);
};

function axis(title, more = {}) {
  return {title: {text: title, standoff: 8}, zeroline: false, gridcolor: "#e6ebf0", linecolor: "#9aa7b3", showline: true,
    ticks: "outside", ticklen: 4, tickcolor: "#9aa7b3", automargin: true, ...more};
}

function layoutOf(more) {
  return {font, margin: {l: 70, r: 20, t: 34, b: 50}, paper_bgcolor: "#fff", plot_bgcolor: "#fff", hovermode: "closest",
    ...more};
}

// Below the abscissa and its label, since the tool bar lies above the plot.
const legendBelow = {legend: {orientation: "h", x: 0.5, xanchor: "center", yref: "container", y: 0.01, yanchor: "bottom"},
  margin: {l: 70, r: 20, t: 34, b: 76}};

function heading(text) {
  return {text, font: {size: 14}, x: 0, xref: "paper", xanchor: "left", y: 1, yref: "paper", yanchor: "bottom",
    pad: {b: 9}};
}

const control = name => document.querySelector(`[data-control="${name}"]`);

function onControl(name, act) {
  const found = control(name);
  if (found) found.addEventListener("input", () => act(found.type === "checkbox" ? found.checked : Number(found.value)));
}

// The pulse that the sliders of all views share.
const chosen = {row: 0, listeners: [], set(row) {
  this.row = row;
  for (const slider of document.querySelectorAll('[data-control^="pulse"]')) slider.value = row;
  for (const listener of this.listeners) listener(row);
}};

function say(problem) {
  const place = document.getElementById("trouble");
  place.hidden = false;
  place.textContent = `This page cannot be drawn here: ${problem}. It needs WebGL and a browser of 2023 or later.`;
}

async function start() {
  try {
    const content = await unpacked("numbers");
    const length = new DataView(content).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(content, 4, length)));
    const data = withArrays(head, content, 4 + length);
    const script = document.createElement("script");
    script.textContent = new TextDecoder().decode(await unpacked("plotly"));
    document.head.append(script);
    for (const view of views) await view(data);
    for (const slider of document.querySelectorAll('[data-control^="pulse"]'))
      slider.addEventListener("input", () => chosen.set(Number(slider.value)));
    if (data.chosen !== undefined) chosen.set(data.chosen);
    document.body.dataset.ready = "yes";
  } catch (error) {
    say(error.message || error);
    throw error;
  }
}
