// The page: one socket that tells what is, buttons that ask for another time, and the operator's hand.

import { Field } from "./field.js";
import { $, Side, clock } from "./side.js";

const SPEEDS = [0.5, 1, 2, 10, 30, 100], TEXT_MS = 200, AGAIN_MS = 1000, ASK_MS = 500;
const field = new Field($("field")), side = new Side(choose);
let socket = null, told = null, dirty = true, live = false, events = [], scrubbing = false, textAt = 0, askedAt = 0;
// What a test may look at.
window.headland = { pictures: 0, told: 0, state: () => told, field };

function connect() {
  socket = new WebSocket(`ws://${location.host}/ws`);
  socket.onopen = () => link("connected");
  socket.onclose = () => { link(null); setTimeout(connect, AGAIN_MS); };
  socket.onmessage = (message) => hear(JSON.parse(message.data));
}

function link(text) {
  $("link").textContent = text ?? "no connection";
  $("link").className = text ? "" : "off";
}

function hear(message) {
  if (message.kind === "scene") return begin(message);
  if (message.kind === "robot") {
    if (message.slot === field.chosen) side.showOne(message, told?.robots.find((r) => r.s === message.slot));
    return;
  }
  if (message.anew) { field.forget(); side.forget(); }
  const paths = new Map((message.anew ? [] : told?.robots ?? []).map((robot) => [robot.s, robot.path]));
  for (const robot of message.robots) robot.path ??= paths.get(robot.s);
  told = message;
  if (message.events) events = message.events;
  side.from = message.from;
  field.take(message);
  side.take(message);
  window.headland.told += 1;
  dirty = true;
}

function begin({ title, scene, live: isLive }) {
  live = isLive;
  told = null;
  field.forget(); side.forget();
  field.setScene(scene);
  $("name").textContent = scene?.name ?? "Headland";
  $("source").textContent = live ? `live · ${title}` : title;
  document.title = `${scene?.name ?? "Headland"} · Headland`;
  $("work-name").textContent = scene?.cells ? "seen" : "work";
  $("hand").hidden = !live;
  dirty = true;
}

function ask(wish) { if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(wish)); }

// ---------------------------------------------------------------- pictures

function picture(now) {
  requestAnimationFrame(picture);
  if (!dirty && !field.stale) return;
  if (dirty) window.headland.pictures += 1;
  dirty = false;
  field.draw(told);
  if (!told || now - textAt < TEXT_MS) return;
  textAt = now;
  side.show(told, field);
  side.showStop(told.stop, told.robots);
  side.showSplit(told.islands);
  $("reset").hidden = told.stop.stopped.length === 0;
  showTime();
  showScale();
  if (field.chosen !== null && now - askedAt > ASK_MS) { askedAt = now; ask({ do: "robot", slot: field.chosen }); }
}

function showTime() {
  const scrub = $("scrub");
  scrub.min = told.from; scrub.max = Math.max(told.until, told.from + 0.1);
  if (!scrubbing) scrub.value = told.t;
  $("clock").textContent = `${clock(told.t - told.from)} / ${clock(told.until - told.from)}`;
  $("play").textContent = told.playing ? "pause" : "play";
  $("live").textContent = live ? "live" : "newest";
  $("live").className = told.follow ? "on" : "";
  $("live").hidden = told.ended;
  for (const button of $("speeds").children)
    button.className = !told.follow && told.playing && Number(button.dataset.speed) === told.speed ? "on" : "";
  side.drawMarks(told, events);
}

function showScale() {
  const metres = [0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500].find((m) => m * field.view.scale >= 60) ?? 1000;
  $("scale").firstElementChild.style.width = `${metres * field.view.scale}px`;
  $("scale").lastElementChild.textContent = `${metres} m`;
}

// ---------------------------------------------------------------- looking around

function choose(slot) {
  field.chosen = field.chosen === slot ? null : slot;
  if (field.chosen === null) side.showOne(null);
  else ask({ do: "robot", slot });
  dirty = true; textAt = 0;
}

let held = null;
$("field").addEventListener("pointerdown", (event) => { held = { x: event.offsetX, y: event.offsetY, moved: 0 }; $("field").setPointerCapture(event.pointerId); });
$("field").addEventListener("pointermove", (event) => {
  if (!held) return;
  const dx = event.offsetX - held.x, dy = event.offsetY - held.y;
  held = { x: event.offsetX, y: event.offsetY, moved: held.moved + Math.abs(dx) + Math.abs(dy) };
  field.pan(dx, dy); dirty = true;
});
$("field").addEventListener("pointerup", (event) => {
  const slot = held && held.moved < 5 && told ? field.at(event.offsetX, event.offsetY, told.robots) : null;
  held = null;
  if (slot !== null) choose(slot);
});
$("field").addEventListener("wheel", (event) => { event.preventDefault(); field.zoom(Math.exp(-event.deltaY / 400), event.offsetX, event.offsetY); dirty = true; }, { passive: false });
$("fit").addEventListener("click", () => { field.fit(told?.robots); dirty = true; });
addEventListener("resize", () => { field.fit(told?.robots); dirty = true; });
for (const box of document.querySelectorAll("[data-layer]"))
  box.addEventListener("change", () => { field.layers[box.dataset.layer] = box.checked; field.stale = dirty = true; });

// ---------------------------------------------------------------- time

for (const speed of SPEEDS) {
  const button = document.createElement("button");
  button.type = "button"; button.textContent = `${speed}×`; button.dataset.speed = speed;
  button.addEventListener("click", () => ask({ do: "speed", value: speed }));
  $("speeds").append(button);
}
$("play").addEventListener("click", () => ask({ do: told?.playing ? "pause" : "play" }));
$("live").addEventListener("click", () => ask({ do: "follow" }));
$("scrub").addEventListener("input", () => { scrubbing = true; ask({ do: "seek", t: Number($("scrub").value) }); });
$("scrub").addEventListener("change", () => { scrubbing = false; });

// ---------------------------------------------------------------- the operator's hand

async function send(path, body) {
  const answer = await fetch(path, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body ?? {}) });
  return answer.json();
}

async function stop() {
  $("release").close();
  $("hand-says").textContent = "stopping …";
  try {
    const { late, heard, problem } = await send("/stop");
    $("hand-says").textContent = problem ?? (!heard ? "nobody was heard: nobody has confirmed" : late.length ? `NOT CONFIRMED by ${late.join(" ")}` : "all have confirmed");
  } catch {
    $("hand-says").textContent = "the map's server does not answer: use a stop on a machine";
  }
}

async function release() {
  $("release-says").textContent = "releasing …";
  try {
    const answer = await send("/reset", { key: $("key").value.trim(), keyless: $("keyless").checked, start: $("start").checked });
    if (answer.problem) { $("release-says").textContent = answer.problem; return; }
    if (!answer.heard || answer.late.length) {
      $("release-says").textContent = answer.heard ? `not released: ${answer.late.join(" ")}` : "nobody was heard";
      return;
    }
    $("release").close();
    $("hand-says").textContent = answer.started ? "released and started" : "released";
  } catch {
    $("release-says").textContent = "the map's server does not answer";
  }
}

$("stop").addEventListener("click", stop);
$("reset").addEventListener("click", () => {
  $("release-says").textContent = "";
  $("release").show(); // not modal: STOP stays within reach
  $("key").focus();
});
$("release-yes").addEventListener("click", release);
$("release-no").addEventListener("click", () => $("release").close());

addEventListener("keydown", (event) => {
  if (event.key === "Escape" && live) stop(); // whatever else is open
  else if (event.target.matches("input[type=text]")) return;
  else if (event.key === " ") { event.preventDefault(); $("play").click(); }
  else if (event.key === "f") $("fit").click();
  else if (event.key === "ArrowLeft" || event.key === "ArrowRight") {
    if (event.target === $("scrub") || !told) return;
    ask({ do: "seek", t: told.t + (event.key === "ArrowLeft" ? -5 : 5) });
  }
});

connect();
requestAnimationFrame(picture);
