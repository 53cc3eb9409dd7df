"use strict";
(() => {
const $ = id => document.getElementById(id);
const meta = JSON.parse($("meta").textContent);
const W = meta.width, H = meta.height, stage = $("stage"), image = $("image"), marks = $("marks");
const view = {x: (W - 1) / 2, y: (H - 1) / 2, zoom: 1};
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const LIST = 300, LARGEST = 160, NUMBERS = 44;
let levels = [], masks = null, quantiles = null, cursor = null, picked = null, pending = false, fitted = true;

// pixels: planes of bytes, lowest first, deflated; value = zero + step * number

async function bytes(id) {
  const text = atob($(id).textContent.trim()), raw = new Uint8Array(text.length);
  for (let i = 0; i < raw.length; i++) raw[i] = text.charCodeAt(i);
  const stream = new Blob([raw]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

async function load() {
  const raw = await bytes("pixels"), count = W * H;
  const data = meta.planes > 2 ? new Uint32Array(count) : new Uint16Array(count);
  data.set(raw.subarray(0, count));
  for (let plane = 1; plane < meta.planes; plane++) {
    const from = plane * count, factor = 256 ** plane;
    for (let i = 0; i < count; i++) data[i] += raw[from + i] * factor;
  }
  levels = pyramid({data, width: W, height: H}, Math.max);
  if (meta.flags.length) masks = pyramid({data: await bytes("flags"), width: W, height: H}, (a, b) => a | b);
  const step = Math.max(1, Math.floor(count / 200000)), some = [];
  for (let i = 0; i < count; i += step) some.push(data[i]);
  quantiles = Float64Array.from(some).sort();
  quantiles[quantiles.length - 1] = levels[levels.length - 1].data.reduce((a, b) => Math.max(a, b));
}

function pyramid(base, join) { // each level half as wide; a block is its brightest pixel, so that no star is lost
  const found = [base];
  while (Math.max(found.at(-1).width, found.at(-1).height) > 256) {
    const {data, width, height} = found.at(-1);
    const w = Math.ceil(width / 2), h = Math.ceil(height / 2), next = new data.constructor(w * h);
    for (let y = 0; y < h; y++) {
      const upper = 2 * y * width, lower = Math.min(2 * y + 1, height - 1) * width;
      for (let x = 0; x < w; x++) {
        const left = 2 * x, right = Math.min(left + 1, width - 1);
        next[y * w + x] = join(join(data[upper + left], data[upper + right]), join(data[lower + left], data[lower + right]));
      }
    }
    found.push({data: next, width: w, height: h});
  }
  return found;
}

const value = number => meta.zero + meta.step * number;
const quantile = part => quantiles[clamp(Math.round(part * (quantiles.length - 1)), 0, quantiles.length - 1)];
const limits = () => {
  const low = quantile($("black").value / 1000);
  const part = 1 - 10 ** (-6 * $("white").value / 1000);
  return [low, Math.max($("white").value == 1000 ? quantiles.at(-1) : quantile(part), low + 1)];
};

const STRETCH = {
  "linear": u => u,
  "square root": Math.sqrt,
  "logarithm": u => Math.log1p(1000 * u) / Math.log1p(1000),
  "asinh": u => Math.asinh(20 * u) / Math.asinh(20),
};
const VIRIDIS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
const COLOURS = {
  "grey": u => [255 * u, 255 * u, 255 * u],
  "inverted": u => [255 - 255 * u, 255 - 255 * u, 255 - 255 * u],
  "viridis": u => {
    const at = clamp(Math.floor(4 * u), 0, 3), t = 4 * u - at;
    return VIRIDIS[at].map((low, i) => low + t * (VIRIDIS[at + 1][i] - low));
  },
};

function shades(low, high) {
  const stretch = STRETCH[$("stretch").value], colour = COLOURS[$("colours").value];
  const size = Math.min(65536, Math.round(high - low) + 1), table = new Uint32Array(size);
  for (let i = 0; i < size; i++) {
    const [r, g, b] = colour(stretch(i / Math.max(size - 1, 1)));
    table[i] = (255 << 24 | Math.round(b) << 16 | Math.round(g) << 8 | Math.round(r)) >>> 0;
  }
  return table;
}

function paintPixels(ratio) {
  const cw = image.width, ch = image.height, scale = view.zoom * ratio;
  const at = clamp(Math.floor(Math.log2(1 / scale)), 0, levels.length - 1), block = 2 ** at;
  const {data, width, height} = levels[at], [low, high] = limits(), table = shades(low, high);
  const factor = (table.length - 1) / (high - low), last = table.length - 1;
  const context = image.getContext("2d"), out = context.createImageData(cw, ch), pixels = new Uint32Array(out.data.buffer);
  const columns = new Int32Array(cw);
  for (let i = 0; i < cw; i++) {
    const x = Math.floor((i + 0.5 - cw / 2) / scale + view.x + 0.5);
    columns[i] = x < 0 || x >= W ? -1 : Math.min(Math.floor(x / block), width - 1);
  }
  const shown = masks && meta.flags.reduce((bits, flag, i) => bits | ($("flag" + i).checked ? flag.bit : 0), 0);
  for (let j = 0; j < ch; j++) {
    const y = Math.floor((j + 0.5 - ch / 2) / scale + view.y + 0.5);
    if (y < 0 || y >= H) continue;
    const row = Math.min(Math.floor(y / block), height - 1) * width;
    for (let i = 0, k = j * cw; i < cw; i++, k++) {
      const column = columns[i];
      if (column < 0) continue;
      const t = (data[row + column] - low) * factor;
      pixels[k] = table[t < 0 ? 0 : t > last ? last : t | 0];
      if (shown) {
        const bits = masks[at].data[row + column] & shown;
        if (bits) pixels[k] = tints[Math.log2(bits & -bits)];
      }
    }
  }
  context.putImageData(out, 0, 0);
}
const tints = new Uint32Array(8);
meta.flags.forEach(flag => {
  const rgb = parseInt(flag.colour.slice(1), 16);
  tints[Math.log2(flag.bit)] = (255 << 24 | (rgb & 255) << 16 | (rgb & 65280) | rgb >> 16) >>> 0;
});

const toScreen = (x, y) => [(x - view.x) * view.zoom + stage.clientWidth / 2, (y - view.y) * view.zoom + stage.clientHeight / 2];
const toFrame = (sx, sy) => [(sx - stage.clientWidth / 2) / view.zoom + view.x, (sy - stage.clientHeight / 2) / view.zoom + view.y];
const magnification = () => 10 ** ($("times").value / 100);

function shape(context, layer, index, sx, sy, radius) {
  context.beginPath();
  if (layer.shape === "arrow") {
    const factor = magnification() * view.zoom, dx = layer.dx[index] * factor, dy = layer.dy[index] * factor;
    const length = Math.hypot(dx, dy), head = Math.min(7, 0.4 * length), turn = Math.atan2(dy, dx);
    context.moveTo(sx, sy);
    context.lineTo(sx + dx, sy + dy);
    for (const side of [-0.45, 0.45]) {
      context.moveTo(sx + dx, sy + dy);
      context.lineTo(sx + dx - head * Math.cos(turn + side), sy + dy - head * Math.sin(turn + side));
    }
  } else if (layer.shape === "cross") {
    for (const [a, b] of [[1, 0], [0, 1]]) {
      context.moveTo(sx - a * radius, sy - b * radius);
      context.lineTo(sx + a * radius, sy + b * radius);
    }
  } else if (layer.shape === "square") {
    context.rect(sx - radius, sy - radius, 2 * radius, 2 * radius);
  } else {
    context.arc(sx, sy, radius, 0, 7);
  }
  context.stroke();
}

const RADIUS = {circle: 9, square: 7, cross: 5, arrow: 0};

function paintMarks(ratio) {
  const context = marks.getContext("2d"), w = stage.clientWidth, h = stage.clientHeight;
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, w, h);
  if (view.zoom >= NUMBERS) paintNumbers(context, w, h);
  context.font = "12px sans-serif";
  const grow = clamp(view.zoom / 6, 1, 3);
  const names = []; // where texts stand: none hides another one
  meta.layers.forEach((layer, which) => {
    if (!$("layer" + which).checked) return;
    const radius = RADIUS[layer.shape] * grow;
    for (let i = 0; i < layer.x.length; i++) {
      const [sx, sy] = toScreen(layer.x[i], layer.y[i]);
      if (sx < -20 || sy < -20 || sx > w + 20 || sy > h + 20) continue;
      const mine = picked && picked.which === which && picked.index === i;
      for (const [colour, thick] of [["rgba(0, 0, 0, 0.55)", 3.2], [layer.colour, mine ? 2.6 : 1.5]]) {
        context.strokeStyle = colour;
        context.lineWidth = thick;
        shape(context, layer, i, sx, sy, radius);
      }
      const tx = sx + radius + 3, ty = sy - radius * 0.5, words = layer.label[i];
      if (words && (mine || names.length < 80 && names.every(([x, y]) => Math.abs(x - tx) > 46 || Math.abs(y - ty) > 13))) {
        names.push([tx, ty]);
        context.lineWidth = 3;
        context.strokeStyle = "rgba(0, 0, 0, 0.7)";
        context.strokeText(words, tx, ty);
        context.fillStyle = layer.colour;
        context.fillText(words, tx, ty);
      }
    }
  });
  if (cursor && cursor.byKey) {
    context.strokeStyle = "#fff";
    context.lineWidth = 1;
    const [sx, sy] = toScreen(cursor.x, cursor.y);
    shape(context, {shape: "cross"}, 0, sx, sy, 14);
  }
}

function paintNumbers(context, w, h) {
  const [x0, y0] = toFrame(0, 0).map(Math.round), [x1, y1] = toFrame(w, h).map(Math.round), [low, high] = limits();
  context.font = "11px monospace";
  context.textAlign = "center";
  for (let y = Math.max(y0, 0); y <= Math.min(y1, H - 1); y++) {
    for (let x = Math.max(x0, 0); x <= Math.min(x1, W - 1); x++) {
      const number = levels[0].data[y * W + x], [sx, sy] = toScreen(x, y);
      const bright = STRETCH[$("stretch").value](clamp((number - low) / (high - low), 0, 1)) > 0.5;
      context.fillStyle = bright !== ($("colours").value === "inverted") ? "#000" : "#fff";
      context.fillText(shown(value(number)), sx, sy + 4);
    }
  }
  context.textAlign = "start";
}

const shown = number => meta.step === 1 ? String(number) : String(+number.toPrecision(6));

function sky(x, y) { // bilinear in a grid of unit vectors; degrees
  const grid = meta.sky;
  if (!grid) return null;
  const u = clamp((x + 0.5) / W, 0, 1) * (grid.columns - 1), v = clamp((y + 0.5) / H, 0, 1) * (grid.rows - 1);
  const i = Math.min(Math.floor(u), grid.columns - 2), j = Math.min(Math.floor(v), grid.rows - 2), a = u - i, b = v - j;
  const at = (p, q, c) => grid.vectors[((j + q) * grid.columns + i + p) * 3 + c];
  const [X, Y, Z] = [0, 1, 2].map(c => (1 - b) * ((1 - a) * at(0, 0, c) + a * at(1, 0, c)) + b * ((1 - a) * at(0, 1, c) + a * at(1, 1, c)));
  const degrees = 180 / Math.PI;
  return [(Math.atan2(Y, X) * degrees + 360) % 360, Math.atan2(Z, Math.hypot(X, Y)) * degrees];
}

function tell() {
  if (!cursor) return;
  const x = Math.round(cursor.x), y = Math.round(cursor.y);
  if (x < 0 || y < 0 || x >= W || y >= H) {
    $("readout").textContent = "outside the frame";
    return;
  }
  const index = y * W + x, words = meta.flags.filter(flag => masks[0].data[index] & flag.bit).map(flag => flag.name);
  const number = words.includes("no value") ? "–" : shown(value(levels[0].data[index]));
  const where = sky(cursor.x, cursor.y);
  $("readout").textContent = `x ${x}, y ${y}: ${number} ${meta.unit}` + (words.length ? ` (${words.join(", ")})` : "") +
    (where ? ` · RA ${where[0].toFixed(4)}°, Dec ${where[1].toFixed(4).replace("-", "−")}°` : "");
}

function draw() {
  pending = false;
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  for (const canvas of [image, marks]) {
    const w = Math.round(stage.clientWidth * ratio), h = Math.round(stage.clientHeight * ratio);
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  }
  const [low, high] = limits();
  $("black-value").textContent = shown(value(low));
  $("white-value").textContent = shown(value(high));
  $("times-value").textContent = `× ${Math.round(magnification())}`;
  paintPixels(ratio);
  paintMarks(ratio);
  tell();
}
const soon = () => { if (!pending) { pending = true; requestAnimationFrame(draw); } };

const fitZoom = () => Math.min(stage.clientWidth / W, stage.clientHeight / H);
function fit(now = soon) {
  fitted = true;
  Object.assign(view, {x: (W - 1) / 2, y: (H - 1) / 2, zoom: fitZoom()});
  now();
}
function zoomTo(zoom, sx = stage.clientWidth / 2, sy = stage.clientHeight / 2) { // what is at (sx, sy) stays there
  const [x, y] = toFrame(sx, sy);
  view.zoom = clamp(zoom, Math.min(fitZoom(), 1) / 2, LARGEST);
  fitted = false;
  moveTo(x - (sx - stage.clientWidth / 2) / view.zoom, y - (sy - stage.clientHeight / 2) / view.zoom);
}
function moveTo(x, y) {
  view.x = clamp(x, -0.5, W - 0.5);
  view.y = clamp(y, -0.5, H - 0.5);
  fitted = false;
  soon();
}

// stars

function nearest(sx, sy) {
  let best = null, least = 16;
  meta.layers.forEach((layer, which) => {
    if (!$("layer" + which).checked || layer.shape === "arrow") return;
    for (let i = 0; i < layer.x.length; i++) {
      const [x, y] = toScreen(layer.x[i], layer.y[i]), far = Math.hypot(x - sx, y - sy);
      if (far < least) [best, least] = [{which, index: i}, far];
    }
  });
  return best;
}

function pick(star, centre) {
  picked = star;
  const layer = meta.layers[star.which], box = $("details"), head = document.createElement("h2"), list = document.createElement("dl");
  head.textContent = `${layer.name}${layer.label[star.index] ? " " + layer.label[star.index] : ""}`;
  const facts = [["x", `${layer.x[star.index].toFixed(3)} px`], ["y", `${layer.y[star.index].toFixed(3)} px`]];
  layer.columns.forEach(column => facts.push([column.name, text(column, star.index)]));
  for (const [name, what] of facts) {
    const term = document.createElement("dt"), meaning = document.createElement("dd");
    [term.textContent, meaning.textContent] = [name, what];
    list.append(term, meaning);
  }
  box.replaceChildren(head, list);
  for (const row of $("rows").children) row.classList.toggle("picked", listed() === star.which && +row.dataset.index === star.index);
  if (centre) {
    if (view.zoom < 8) view.zoom = 8;
    moveTo(layer.x[star.index], layer.y[star.index]);
  }
  soon();
}

const text = (column, index) => {
  const what = column.values[index];
  if (what === null) return "–";
  return (typeof what === "number" ? String(+what.toPrecision(6)).replace("-", "−") : what) + (column.unit ? ` ${column.unit}` : "");
};
const listed = () => +$("listed").value;

function fillList() {
  const which = listed(), layer = meta.layers[which], count = Math.min(layer.x.length, LIST);
  const heads = document.createElement("tr"), rows = [];
  for (const name of ["", "x [px]", "y [px]", ...layer.columns.map(column => column.name + (column.unit ? ` [${column.unit}]` : ""))]) {
    const cell = document.createElement("th");
    cell.scope = "col";
    cell.textContent = name;
    heads.append(cell);
  }
  for (let i = 0; i < count; i++) {
    const row = document.createElement("tr");
    row.dataset.index = i;
    row.tabIndex = 0;
    for (const cell of [layer.label[i] || `${i + 1}`, layer.x[i].toFixed(2), layer.y[i].toFixed(2), ...layer.columns.map(column => text({...column, unit: ""}, i))]) {
      row.insertCell().textContent = cell;
    }
    rows.push(row);
  }
  $("heads").replaceChildren(heads);
  $("rows").replaceChildren(...rows);
  $("more").textContent = layer.x.length > count ? `The first ${count} of ${layer.x.length}.` : "";
}

function step(by) {
  if (!meta.layers.length) return;
  const which = listed(), count = Math.min(meta.layers[which].x.length, LIST);
  if (!count) return;
  const now = picked && picked.which === which ? picked.index : by > 0 ? -1 : count;
  pick({which, index: (now + by + count) % count}, true);
}

// controls

function addLayer(id, name, count, colour, checked, draws) {
  const label = document.createElement("label"), box = document.createElement("input"), swatch = document.createElement("canvas");
  Object.assign(box, {type: "checkbox", id, checked});
  [swatch.className, swatch.width, swatch.height] = ["swatch", 36, 36];
  swatch.setAttribute("aria-hidden", "true");
  const context = swatch.getContext("2d");
  [context.strokeStyle, context.fillStyle, context.lineWidth] = [colour, colour, 3.5];
  draws(context);
  const number = document.createElement("span");
  number.className = "count";
  number.textContent = count;
  label.append(box, swatch, name, number);
  $("layers").append(label);
  box.addEventListener("change", soon);
}

meta.layers.forEach((layer, which) => {
  addLayer("layer" + which, layer.name, layer.x.length, layer.colour, layer.shown, context => {
    if (layer.shape !== "arrow") return shape(context, layer, 0, 18, 18, 11);
    context.beginPath();
    for (const [x, y] of [[6, 30], [30, 6], [18, 8], [30, 6], [28, 18]]) context.lineTo(x, y);
    context.stroke();
  });
  if (layer.shape === "arrow") $("arrows").hidden = false;
  else $("listed").append(new Option(layer.name, which));
});
meta.flags.forEach((flag, i) => addLayer("flag" + i, `${flag.name} pixels`, flag.count, flag.colour, true, context => context.fillRect(9, 9, 18, 18)));
$("layers").hidden = !meta.layers.length && !meta.flags.length;
if ($("listed").options.length) {
  $("list").hidden = false;
  fillList();
  $("listed").addEventListener("change", fillList);
}
$("times").value = 100 * Math.log10(meta.times);
for (const id of ["stretch", "colours", "black", "white", "times"]) $(id).addEventListener("input", soon);
$("controls").addEventListener("submit", event => event.preventDefault());
$("in").addEventListener("click", () => zoomTo(view.zoom * 1.6));
$("out").addEventListener("click", () => zoomTo(view.zoom / 1.6));
$("fit").addEventListener("click", () => fit());
$("one").addEventListener("click", () => zoomTo(1));
const chosen = event => event.target.closest("tr");
$("rows").addEventListener("click", event => pick({which: listed(), index: +chosen(event).dataset.index}, true));
$("rows").addEventListener("keydown", event => { if (event.key === "Enter") pick({which: listed(), index: +chosen(event).dataset.index}, true); });

const fingers = new Map();
let travelled = 0;
const place = event => {
  const box = stage.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
};
const span = () => {
  const [a, b] = [...fingers.values()];
  return {x: (a[0] + b[0]) / 2, y: (a[1] + b[1]) / 2, apart: Math.hypot(a[0] - b[0], a[1] - b[1])};
};
stage.addEventListener("pointerdown", event => {
  try { stage.setPointerCapture(event.pointerId); } catch { /* a pointer that is gone */ }
  if (!fingers.size) travelled = 0;
  fingers.set(event.pointerId, place(event));
});
stage.addEventListener("pointermove", event => {
  const now = place(event), before = fingers.get(event.pointerId);
  const [x, y] = toFrame(...now);
  cursor = {x, y};
  if (before && fingers.size === 1) {
    travelled += Math.hypot(now[0] - before[0], now[1] - before[1]);
    fingers.set(event.pointerId, now);
    if (travelled > 4) moveTo(view.x - (now[0] - before[0]) / view.zoom, view.y - (now[1] - before[1]) / view.zoom);
  } else if (before) {
    const was = span();
    fingers.set(event.pointerId, now);
    const is = span();
    travelled = 99;
    moveTo(view.x - (is.x - was.x) / view.zoom, view.y - (is.y - was.y) / view.zoom);
    zoomTo(view.zoom * is.apart / Math.max(was.apart, 1), is.x, is.y);
  }
  tell();
});
stage.addEventListener("pointerup", event => {
  if (fingers.delete(event.pointerId) && !fingers.size && travelled <= 4) {
    const star = nearest(...place(event)), [x, y] = toFrame(...place(event));
    cursor = {x, y};
    if (star) pick(star, false);
    tell();
  }
});
stage.addEventListener("pointercancel", event => fingers.delete(event.pointerId));
stage.addEventListener("wheel", event => {
  event.preventDefault();
  zoomTo(view.zoom * 2 ** (-event.deltaY * (event.deltaMode ? 0.08 : 0.004)), ...place(event));
}, {passive: false});
stage.addEventListener("dblclick", event => zoomTo(view.zoom * 3, ...place(event)));

const MOVES = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]};
stage.addEventListener("keydown", event => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const move = MOVES[event.key], keys = {"+": 1.6, "=": 1.6, "-": 1 / 1.6, "−": 1 / 1.6};
  if (move) {
    const by = event.shiftKey ? 1 : 0.12 * stage.clientWidth / view.zoom;
    moveTo((event.shiftKey ? Math.round(view.x) : view.x) + move[0] * by, (event.shiftKey ? Math.round(view.y) : view.y) + move[1] * by);
  } else if (keys[event.key]) zoomTo(view.zoom * keys[event.key]);
  else if (event.key === "0") fit();
  else if (event.key === "1") zoomTo(1);
  else if (event.key === "n" || event.key === "N") step(1);
  else if (event.key === "p" || event.key === "P") step(-1);
  else return;
  event.preventDefault();
  cursor = {x: view.x, y: view.y, byKey: true};
  tell();
});

new ResizeObserver(() => {
  if (!levels.length) return; // drawn at once: a canvas of the old size would be stretched
  if (fitted) fit(draw);
  else draw();
}).observe(stage);

load().then(() => {
  document.documentElement.classList.add("ready");
  const white = Math.log10(1 - meta.white) / -6 * 1000;
  [$("black").value, $("white").value] = [1000 * meta.black, white];
  fit(draw);
  document.documentElement.dataset.openedMs = Math.round(performance.now());
}).catch(error => {
  $("readout").textContent = `This browser cannot show the frame: ${error.message}`;
  document.documentElement.dataset.failed = error.message;
});
})();
