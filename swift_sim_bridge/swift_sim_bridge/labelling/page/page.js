"use strict";
// One frame at a time: its gates are shown as quadrilaterals, a person corrects them, Enter sends them.
// Coordinates are those of pixel centres, as in labels.json: the image reaches from -0.5 to its width - 0.5.

const NOT_LABELLED = 0, OCCLUDED = 1, VISIBLE = 2;
const SHORT = ["TL", "TR", "BR", "BL"];
const REACH_PX = 26;      // screen distance within which a press takes a corner
const MARGIN = 0.06;      // of the image's size, around it, for corners outside of it
const MAGNIFICATION = 8;  // of the magnifier, screen pixels for a pixel of a small image
const MOST_ZOOM = 20;
const SVG = "http://www.w3.org/2000/svg";

const at = (id) => document.getElementById(id);
const view = at("view"), magnifier = at("magnifier"), pen = magnifier.getContext("2d");

let session = null;       // names and labelled of all frames
let number = 0;           // of the shown frame
let frame = null;         // as the server sent it, with the gates as they are now
let picture = new Image();
let selected = -1, corner = -1;  // gate and corner of the next key
let adding = null;        // corners of a gate that is being added
let drag = null;
let zoom = 1;
let undo = [], actions = [], shownAt = 0;
let busy = false;
const ahead = new Map();  // pictures of the next frames

async function request(path, body) {
  const options = body ? {method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify(body)} : {};
  let answer;
  try {
    answer = await fetch(path, options);
  } catch {
    throw new Error("the server does not answer; start `swiftros label` again, nothing accepted is lost");
  }
  const content = await answer.json();
  if (!answer.ok) throw new Error(content.error);
  return content;
}

function say(text, wrong = false) {
  const line = at("message");
  line.className = wrong ? "wrong" : "";
  line.replaceChildren();
  if (text) line.appendChild(document.createElement("span")).textContent = text;
}

function load(index) {
  if (!ahead.has(index)) {
    const image = new Image();
    image.src = `picture/${index}`;
    ahead.set(index, image);
  }
  return ahead.get(index);
}

async function show(index) {
  if (index < 0 || index >= session.names.length) return say("there is no further image");
  try {
    picture = load(index);
    const [content] = await Promise.all([request(`frame/${index}`), picture.decode()]);
    number = index;
    frame = content;
  } catch (error) {
    return say(error.message, true);
  }
  for (const gate of frame.gates) gate.proposal = frame.gates.indexOf(gate);
  undo = []; actions = []; adding = null; drag = null;
  selected = frame.gates.length ? 0 : -1; corner = -1;
  shownAt = performance.now();
  say(frame.gates.length ? "" : "no gate is proposed: add one with A, or accept an image without a gate");
  look(frame.width / 2 - 0.5, frame.height / 2 - 0.5, 1);
  const image = at("image");
  for (const [key, value] of Object.entries({x: -0.5, y: -0.5, width: frame.width, height: frame.height})) {
    image.setAttribute(key, value);
  }
  image.setAttribute("href", picture.src);
  image.setAttribute("class", frame.width < 900 ? "pixelated" : "");
  document.body.dataset.frame = number;
  draw();
  for (const key of ahead.keys()) if (Math.abs(key - number) > 3) ahead.delete(key);
  if (number + 1 < session.names.length) { load(number + 1); fetch(`frame/${number + 1}`).catch(() => {}); }
}

// Show the image magnified by a factor, with a point of the image where it is on the screen.
function look(u, v, factor) {
  const width = frame.width * (1 + 2 * MARGIN), height = frame.height * (1 + 2 * MARGIN);
  const now = factor === 1 ? {x: -0.5 - MARGIN * frame.width, y: -0.5 - MARGIN * frame.height, width, height}
    : view.viewBox.baseVal;
  const shrink = factor === 1 ? 1 : width / factor / now.width;
  const left = u - (u - now.x) * shrink, top = v - (v - now.y) * shrink;
  view.setAttribute("viewBox", `${left} ${top} ${now.width * shrink} ${now.height * shrink}`);
  zoom = factor;
}

function draw() {
  const scale = 1 / pixelSize();
  const drawn = frame.gates.map((gate, index) => gateElement(gate, index, scale));
  if (adding) drawn.push(gateElement({corners: adding, visibility: adding.map(() => VISIBLE), origin: "added"}, -2, scale));
  at("gates").replaceChildren(...drawn);
  at("list").replaceChildren(...frame.gates.map(listElement));
  at("all").checked = frame.all_gates;
  at("name").textContent = session.names[number];
  const done = session.labelled.filter(Boolean).length;
  at("count").textContent = `image ${number + 1} of ${session.names.length}, ${done} labelled`;
  at("progress").value = done / session.names.length;
  at("state").textContent = frame.labelled ? "labelled" : "proposed";
  at("state").className = frame.labelled ? "badge done" : "badge";
}

function gateElement(gate, index, scale) {
  const group = document.createElementNS(SVG, "g");
  group.setAttribute("class", `gate ${gate.origin}${index === selected ? " selected" : ""}`);
  group.dataset.gate = index;
  const known = gate.corners.filter((_, k) => gate.visibility[k] !== NOT_LABELLED);
  const middle = [0, 1].map((axis) => known.reduce((sum, one) => sum + one[axis], 0) / known.length);
  const outline = document.createElementNS(SVG, "polygon");
  outline.setAttribute("points", known.map(([u, v]) => `${u},${v}`).join(" "));
  group.appendChild(outline);
  gate.corners.forEach(([u, v], k) => {
    if (gate.visibility[k] === NOT_LABELLED) return;
    const dot = document.createElementNS(SVG, "circle");
    dot.setAttribute("cx", u);
    dot.setAttribute("cy", v);
    dot.setAttribute("r", 6 * scale);
    dot.dataset.corner = SHORT[k];
    const chosen = index === selected && k === corner ? " chosen" : "";
    dot.setAttribute("class", (gate.visibility[k] === OCCLUDED ? "occluded" : "visible") + chosen);
    group.appendChild(dot);
    if (index !== selected && index !== -2) return;
    const name = document.createElementNS(SVG, "text");
    const outwards = [u - middle[0], v - middle[1]].map((one) => one / (Math.hypot(u - middle[0], v - middle[1]) || 1));
    name.setAttribute("x", u + 18 * scale * outwards[0]);
    name.setAttribute("y", v + 18 * scale * outwards[1]);
    name.setAttribute("font-size", 13 * scale);
    name.textContent = SHORT[k];
    group.appendChild(name);
  });
  return group;
}

function listElement(gate, index) {
  const row = document.createElement("li");
  row.className = `${gate.origin}${index === selected ? " selected" : ""}`;
  row.textContent = `gate ${index + 1}`;
  row.appendChild(document.createElement("span")).textContent = gate.origin;
  row.onclick = () => { selected = index; corner = -1; draw(); };
  return row;
}

// Size of a pixel of the image on the screen.
function pixelSize() {
  const box = view.viewBox.baseVal, room = view.getBoundingClientRect();
  return Math.min(room.width / box.width, room.height / box.height) || 1;
}

function pointOf(event) {
  const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(view.getScreenCTM().inverse());
  return [point.x, point.y];
}

function nearest(point) {
  let best = null;
  frame.gates.forEach((gate, index) => gate.corners.forEach(([u, v], k) => {
    if (gate.visibility[k] === NOT_LABELLED) return;
    const away = Math.hypot(u - point[0], v - point[1]) - (index === selected ? 1e-6 : 0);
    if (!best || away < best.away) best = {index, k, away};
  }));
  return best && best.away * pixelSize() <= REACH_PX ? best : null;
}

function record(what, details = {}) {
  actions.push({seconds: Math.round(performance.now() - shownAt) / 1000, what, ...details});
}

function remember() {
  undo.push(JSON.stringify({gates: frame.gates, all_gates: frame.all_gates, selected}));
  say("");
}

view.addEventListener("pointerdown", (event) => {
  if (!frame || event.button !== 0) return;
  view.focus();
  const point = pointOf(event);
  if (adding) {
    adding.push(point);
    record("click", {corner: SHORT[adding.length - 1]});
    if (adding.length === 4) finishAdding();
    else say(`click ${SHORT[adding.length]}`);
    return draw();
  }
  const found = nearest(point);
  if (!found) return;
  selected = found.index; corner = found.k;
  const gate = frame.gates[selected];
  drag = {whole: event.shiftKey, from: point, before: gate.corners.map((one) => [...one]), moved: false};
  view.setPointerCapture(event.pointerId);
  draw();
});

view.addEventListener("pointermove", (event) => {
  if (!frame) return;
  const point = pointOf(event);
  if (drag) {
    const shift = [point[0] - drag.from[0], point[1] - drag.from[1]];
    if (!drag.moved && Math.hypot(...shift) * pixelSize() < 2) return;
    if (!drag.moved) remember();
    drag.moved = true;
    drag.before.forEach(([u, v], k) => {
      if (drag.whole || k === corner) frame.gates[selected].corners[k] = [u + shift[0], v + shift[1]];
    });
    draw();
  }
  magnify(drag && !drag.whole ? frame.gates[selected].corners[corner] : point);
});

view.addEventListener("pointerup", () => {
  if (drag && drag.moved) record(drag.whole ? "drag gate" : "drag", {gate: selected, corner: SHORT[corner]});
  drag = null;
});

view.addEventListener("wheel", (event) => {
  if (!frame) return;
  event.preventDefault();
  look(...pointOf(event), Math.min(Math.max(zoom * Math.exp(-event.deltaY / 400), 1), MOST_ZOOM));
  draw();
}, {passive: false});

function magnify([u, v]) {
  const side = magnifier.width, zoom = Math.max(MAGNIFICATION * 384 / Math.max(frame.width, 384), 1.5 * pixelSize());
  const span = side / zoom;
  pen.imageSmoothingEnabled = false;
  pen.fillStyle = "#000";
  pen.fillRect(0, 0, side, side);
  pen.drawImage(picture, u + 0.5 - span / 2, v + 0.5 - span / 2, span, span, 0, 0, side, side);
  pen.strokeStyle = "#ffffffb0";
  pen.beginPath();
  for (const [x0, y0, x1, y1] of [[0, .5, .44, .5], [.56, .5, 1, .5], [.5, 0, .5, .44], [.5, .56, .5, 1]]) {
    pen.moveTo(x0 * side, y0 * side);
    pen.lineTo(x1 * side, y1 * side);
  }
  pen.stroke();
}

function finishAdding() {
  remember();
  frame.gates.push({corners: adding, visibility: [2, 2, 2, 2], origin: "added", proposal: null});
  adding = null;
  selected = frame.gates.length - 1; corner = -1;
  say("");
}

async function accept() {
  if (busy) return;
  if (adding) return say("click the other corners of the new gate, or press Escape", true);
  busy = true;
  const seconds = (performance.now() - shownAt) / 1000;
  record("accept");
  const gates = frame.gates.map(({corners, visibility, proposal}) => ({corners, visibility, proposal}));
  try {
    session = await request(`frame/${number}`, {gates, all_gates: frame.all_gates, seconds, actions});
    frame.labelled = true;
    if (number + 1 < session.names.length) await show(number + 1);
    else { draw(); say("this was the last image"); }
  } catch (error) {
    say(error.message, true);
  } finally {
    busy = false;
  }
}

const KEYS = {
  Enter: accept,
  ArrowRight: () => show(number + 1),
  ArrowLeft: () => show(number - 1),
  Escape: () => { adding = null; say(""); draw(); },
  Tab: () => { if (frame.gates.length) { selected = (selected + 1) % frame.gates.length; corner = -1; draw(); } },
  a: () => { adding = []; record("add"); say("click the inner corners: TL, TR, BR, BL"); },
  d: () => {
    if (selected < 0) return;
    remember();
    frame.gates.splice(selected, 1);
    record("delete", {gate: selected});
    selected = Math.min(selected, frame.gates.length - 1); corner = -1;
    draw();
  },
  o: () => switchCorner("occluded", (now) => now === OCCLUDED ? VISIBLE : OCCLUDED),
  x: () => {
    const missing = selected < 0 ? -1 : frame.gates[selected].visibility.indexOf(NOT_LABELLED);
    if (corner < 0 && missing >= 0) { corner = missing; placeCorner(); }
    switchCorner("labelled", (now) => now === NOT_LABELLED ? VISIBLE : NOT_LABELLED);
  },
  g: () => { remember(); frame.all_gates = !frame.all_gates; record("all gates"); draw(); },
  u: () => {
    if (!undo.length) return say("nothing to undo");
    const before = JSON.parse(undo.pop());
    frame.gates = before.gates;
    frame.all_gates = before.all_gates;
    selected = before.selected; corner = -1;
    say("");
    record("undo");
    draw();
  },
  n: () => {
    const next = session.labelled.findIndex((done, index) => !done && index > number);
    return show(next >= 0 ? next : session.labelled.indexOf(false));
  },
};

// Put a corner that was not labelled where the others make a parallelogram.
function placeCorner() {
  const {corners} = frame.gates[selected];
  const [before, opposite, after] = [3, 2, 1].map((step) => corners[(corner + step) % 4]);
  corners[corner] = [0, 1].map((axis) => before[axis] + after[axis] - opposite[axis]);
}

function switchCorner(what, change) {
  if (selected < 0 || corner < 0) return say("click a corner first", true);
  remember();
  const {visibility} = frame.gates[selected];
  visibility[corner] = change(visibility[corner]);
  record(what, {gate: selected, corner: SHORT[corner]});
  draw();
}

document.addEventListener("keydown", (event) => {
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (!frame || !KEYS[key] || event.altKey || event.metaKey || event.ctrlKey) return;
  event.preventDefault();
  if (!event.repeat) KEYS[key]();
});

at("all").addEventListener("change", () => { KEYS.g(); view.focus(); });
window.addEventListener("resize", () => frame && draw());

(async () => {
  try {
    session = await request("session");
  } catch (error) {
    return say(error.message, true);
  }
  const first = session.labelled.indexOf(false);
  await show(first < 0 ? 0 : first);
  view.focus();
})();
