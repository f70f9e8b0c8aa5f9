// The page: one socket that tells what is, buttons that ask for another time, and the operator's hand.

import { Field, setColours } from "./field.js";
import { $, Side, clock, set } from "./side.js";

const SPEEDS = [0.5, 1, 2, 10, 30, 100], TEXT_MS = 200, AGAIN_MS = 1000, ASK_MS = 500;
const OLD_S = 2; // twice what makes a robot silent: then nothing here is a picture of now
const STEP_S = 5, ZOOM = 1.4; // of one key or button
const NO_TOKEN = 4401, TOO_MANY = 1013; // close codes of the map's server
const field = new Field($("field")), side = new Side(choose, (section) => ask({ do: "why", section }));
let socket = null, told = null, dirty = true, live = false, releases = false, events = [], scrubbing = false;
let heard = 0, drawn = 0, heardAt = performance.now(), textAt = 0, askedAt = 0, denied = false, full = "";
let one = null; // the server's last word about the chosen robot
// What a test may look at.
window.headland = { pictures: 0, told: 0, state: () => told, field };

// The token comes behind the # of the printed address; a page that is loaded again still has it.
let token = "";
function takeToken() {
  if (location.hash.length > 1) {
    sessionStorage.setItem("token", location.hash.slice(1));
    history.replaceState(null, "", location.pathname);
  }
  token = sessionStorage.getItem("token") ?? "";
}

function connect() {
  socket = new WebSocket(`ws://${location.host}/ws`, token ? ["headland", token] : ["headland"]);
  socket.onclose = ({ code, reason }) => {
    denied = code === NO_TOKEN;
    full = code === TOO_MANY ? reason : "";
    link("no connection");
    if (denied || full) { $("hand").hidden = false; $("reset").hidden = $("start").hidden = true; } // a stop needs no picture
    if (!denied) setTimeout(connect, AGAIN_MS);
  };
  socket.onmessage = (message) => hear(JSON.parse(message.data));
}

function link(text) {
  set($("link"), text);
  $("link").className = text === "connected" ? "on" : "off";
}

function hear(message) {
  heardAt = performance.now();
  if (message.kind === "scene") return begin(message);
  if (message.kind === "robot") {
    one = message;
    return showOne();
  }
  if (message.kind === "why") return side.showWhy(message);
  if (message.jumped) { field.forget(); side.forget(); }
  const paths = new Map((message.jumped ? [] : told?.robots ?? []).map((robot) => [robot.s, robot.path]));
  for (const robot of message.robots) robot.path ??= paths.get(robot.s);
  told = message;
  side.from = message.from;
  if (message.events) side.showEvents(events = message.events, (t) => ask({ do: "seek", t }));
  field.take(message);
  if (!field.fitted) fit();
  side.take(message);
  window.headland.told += 1;
  heard += 1;
  dirty = true;
}

function begin({ title, scene, live: isLive, releases: mayRelease, colours }) {
  live = isLive; releases = mayRelease; denied = false; full = "";
  told = one = null;
  side.showEvents(events = [], () => {});
  heard = drawn = 0;
  setColours(colours);
  field.forget(); side.forget();
  field.setScene(scene);
  $("name").textContent = scene?.name ?? "Headland";
  $("source").textContent = live ? `live · ${title}` : title;
  document.title = `${scene?.name ?? "Headland"} · Headland`;
  $("has").textContent = scene?.bays ? "tasks" : "section";
  $("work-name").textContent = scene?.cells ? "seen" : scene?.bays ? "delivered" : "work";
  $("walls-line").hidden = !scene?.cells;
  side.showWhy(null); keep(false);
  $("hand").hidden = !live;
  dirty = true;
}

function ask(wish) { if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(wish)); }

// ---------------------------------------------------------------- pictures

function picture(now) {
  requestAnimationFrame(picture);
  const text = now - textAt >= TEXT_MS;
  if (text) { textAt = now; showAge(now); }
  if (kept && told) centre();
  if (!dirty && !field.stale) return;
  field.draw(told);
  if (heard > drawn) {
    window.headland.pictures += 1;
    drawn = heard;
    ask({ do: "drawn", count: drawn });
  }
  dirty = false;
  if (!told || !text) return;
  side.show(told, field);
  showOne();
  side.showStop(told.stop, told.robots);
  side.showSplit(told.islands);
  $("keyless-fleet").hidden = told.keyed !== false;
  showOrders();
  showTime();
  showScale();
  if (field.chosen !== null && now - askedAt > ASK_MS) { askedAt = now; ask({ do: "robot", slot: field.chosen }); }
}

// How old the picture is: by its own clock, the server's last word, and the last frame of the bus.
function showAge(now) {
  const unheard = (now - heardAt) / 1000, quiet = live && told ? told.quiet + unheard : unheard;
  const old = denied || full !== "" || unheard > OLD_S || (live && told !== null && quiet > OLD_S);
  const behind = live && told && !told.follow;
  if (presses > answered && unheard > OLD_S && !denied && !full) set($("hand-says"), NO_ANSWER); // a server that hangs refuses nothing
  if (old !== document.body.classList.contains("old")) { document.body.classList.toggle("old", old); dirty = true; }
  side.old = old;
  $("old").hidden = !old;
  set($("old-age"), denied || full ? "NO PICTURE" : live && told ? `PICTURE IS ${Math.floor(quiet)} s OLD` : "NO CONNECTION");
  set($("old-why"), denied
    ? "This address lacks its token: open the whole address that the map printed." + (live || !told ? " STOP works without it." : "")
    : full ? `${full}: close one of them.` + (live || !told ? " STOP works all the same." : "")
    : unheard > OLD_S ? "The map's server does not answer. Robots may be moving." : "Nothing is heard on the bus. Robots may be moving.");
  $("paused").hidden = !behind || old;
  if (behind) $("paused-age").textContent = clock(told.until - told.t);
  link(socket?.readyState !== WebSocket.OPEN || unheard > OLD_S ? "no connection" : old ? "bus quiet" : "connected");
}

// A release where robots stand latched; a start where some were released, or booted, and got none.
function showOrders() {
  const here = told.robots.filter((robot) => !robot.silent && !robot.left);
  $("reset").hidden = told.stop.stopped.length === 0;
  $("start").hidden = !here.some((robot) => !robot.started && !robot.stopped);
}

function showTime() {
  const scrub = $("scrub");
  scrub.min = told.from; scrub.max = Math.max(told.until, told.from + 0.1);
  if (!scrubbing) scrub.value = told.t;
  scrub.setAttribute("aria-valuetext", `${clock(told.t - told.from)} of ${clock(told.until - told.from)}`);
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
  $("scale").querySelector("i").style.width = `${metres * field.view.scale}px`;
  $("metres").textContent = `${metres} m`;
}

// ---------------------------------------------------------------- looking around

function choose(slot) {
  field.chosen = field.chosen === slot ? null : slot;
  keep(false);
  showOne();
  if (field.chosen !== null) ask({ do: "robot", slot });
  dirty = true; textAt = 0;
}

// Not of a time at which it was not there, nor as if it were of now where the picture is old.
function showOne() {
  const robot = told?.robots.find((each) => each.s === field.chosen);
  side.showOne(robot && one?.slot === robot.s ? one : null, robot);
}

// The chosen robot stays in the middle, until a person looks elsewhere.
let kept = false;
function keep(on) { kept = on; $("with").setAttribute("aria-pressed", String(on)); $("with").className = on ? "on" : ""; }
function centre() {
  const robot = told.robots.find((each) => each.s === field.chosen);
  if (!robot || robot.nowhere) return keep(false);
  const { x, y } = field.view;
  if (Math.hypot(robot.x - x, robot.y - y) * field.view.scale < 1) return;
  field.view.x = robot.x; field.view.y = robot.y;
  field.moved = field.stale = dirty = true;
}
$("with").addEventListener("click", () => keep(!kept));
$("why-no").addEventListener("click", () => side.showWhy(null));

function showPlace(px, py) {
  const at = field.toField(px, py), earth = field.earth(at);
  const [x, y] = at.map((value) => value.toFixed(1));
  const text = earth ? ` · ${earth[0].toFixed(6)}, ${earth[1].toFixed(6)}` : "";
  $("place").textContent = `${x} m east, ${y} m north${text}`;
}

const pointers = new Map(); // of fingers or the mouse on the map, by identifier
let moved = 0;

function middle() {
  const [first, second = first] = [...pointers.values()];
  return { x: (first.x + second.x) / 2, y: (first.y + second.y) / 2, span: Math.hypot(first.x - second.x, first.y - second.y) };
}

$("field").addEventListener("pointerdown", (event) => {
  if (pointers.size === 2) return;
  if (!pointers.size) moved = 0;
  pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
  $("field").setPointerCapture(event.pointerId);
});
$("field").addEventListener("pointermove", (event) => {
  showPlace(event.offsetX, event.offsetY);
  if (!pointers.has(event.pointerId)) return;
  const before = middle();
  pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
  const after = middle();
  if (moved > 5) keep(false);
  moved += Math.abs(after.x - before.x) + Math.abs(after.y - before.y) + Math.abs(after.span - before.span);
  field.pan(after.x - before.x, after.y - before.y);
  if (before.span > 0 && after.span > 0) field.zoom(after.span / before.span, after.x, after.y);
  dirty = true;
});
for (const kind of ["pointerup", "pointercancel"])
  $("field").addEventListener(kind, (event) => {
    const single = pointers.size === 1 && pointers.delete(event.pointerId);
    pointers.delete(event.pointerId);
    const slot = kind === "pointerup" && single && moved < 5 && told ? field.at(event.offsetX, event.offsetY, told.robots) : null;
    if (slot !== null) { choose(slot); return; }
    const section = kind === "pointerup" && single && moved < 5 && told ? field.sectionAt(event.offsetX, event.offsetY) : null;
    if (section === null) return;
    ask({ do: "why", section });
    document.body.classList.add("sheet"); $("sheet").setAttribute("aria-expanded", "true");
  });
$("field").addEventListener("wheel", (event) => { event.preventDefault(); field.zoom(Math.exp(-event.deltaY / 400), event.offsetX, event.offsetY); dirty = true; }, { passive: false });

function fit() {
  const main = document.querySelector("main"), layers = $("layers").getBoundingClientRect(), box = main.getBoundingClientRect();
  const atFoot = layers.height > 0 && layers.top > box.top + box.height / 2;
  const zoom = $("zoom").getBoundingClientRect(), beside = zoom.height > zoom.width;
  field.fit(told?.robots, {
    top: beside ? 0 : zoom.bottom - box.top, left: beside ? zoom.right - box.left : 0,
    bottom: atFoot ? box.bottom - layers.top : 30,
  });
  dirty = true;
}

function closer(factor) { field.zoom(factor, $("field").clientWidth / 2, $("field").clientHeight / 2); dirty = true; }

function toggled(name, button) { button.setAttribute("aria-expanded", String(document.body.classList.toggle(name))); }

$("fit").addEventListener("click", fit);
$("nearer").addEventListener("click", () => closer(ZOOM));
$("farther").addEventListener("click", () => closer(1 / ZOOM));
$("sheet").addEventListener("click", () => toggled("sheet", $("sheet")));
$("layers-open").addEventListener("click", () => toggled("layers", $("layers-open")));
new ResizeObserver(() => { if (field.fitted && !field.moved) fit(); dirty = field.stale = true; }).observe($("field"));
for (const box of document.querySelectorAll("[data-layer]"))
  box.addEventListener("change", () => { field.layers[box.dataset.layer] = box.checked; field.stale = dirty = true; });

// ---------------------------------------------------------------- time

for (const speed of SPEEDS) {
  const button = document.createElement("button");
  button.type = "button"; button.setAttribute("aria-label", `${speed} times real time`); button.textContent = `${speed}×`; button.dataset.speed = speed;
  button.addEventListener("click", () => ask({ do: "speed", value: speed }));
  $("speeds").append(button);
}
$("play").addEventListener("click", () => ask({ do: told?.playing ? "pause" : "play" }));
for (const id of ["live", "resume"]) $(id).addEventListener("click", () => ask({ do: "follow" }));
$("scrub").addEventListener("input", () => { scrubbing = true; ask({ do: "seek", t: Number($("scrub").value) }); });
$("scrub").addEventListener("change", () => { scrubbing = false; });

// ---------------------------------------------------------------- the operator's hand

async function send(path, body) {
  const headers = { "content-type": "application/json" };
  if (token) headers.authorization = `Bearer ${token}`;
  const answer = await fetch(path, { method: "POST", headers, body: JSON.stringify(body ?? {}) });
  return answer.json();
}

const NO_ANSWER = "the map's server does not answer: use a stop on a machine";
let presses = 0, answered = 0; // of STOP

async function stop() {
  $("release").close(); $("help").close();
  $("hand-says").textContent = "stopping …";
  presses += 1;
  try {
    const { late, unnamed, heard, problem } = await send("/stop");
    const missing = problem ? [] : [...late, ...unnamed.map((address) => `address ${address}`)];
    $("hand-says").textContent = problem ?? (missing.length ? `NOT CONFIRMED by ${missing.join(" ")}` : heard ? "all have confirmed" : "no robot was heard: none has confirmed");
  } catch {
    $("hand-says").textContent = NO_ANSWER;
  }
  answered += 1;
}

const RELEASE = "Look at the robots first: nobody near them, nothing under them. This clears the stops that are shown and resets each machine.";
const START = "Look at the robots first: nobody near them, nothing under them. Every robot that is not stopped begins to work and to move.";
let order = "reset"; // what the form is about

function openRelease(what) {
  const starts = (order = what) === "start";
  $("release-name").textContent = starts ? "Start the work" : "Release the fleet";
  $("release-what").textContent = starts ? START : RELEASE;
  $("release-key").textContent = releases ? "Signed with the operator's key that this map was started with." : "This map was started without an operator's key (--operator-key): from here only a fleet without keys obeys.";
  $("keyless-line").hidden = releases;
  $("also-line").hidden = starts;
  $("release-yes").textContent = starts ? "start" : "release";
  $("release-says").textContent = "";
  $("also").checked = false; // said again for each release
  $("release").show(); // not modal: STOP stays within reach
  (releases ? $("release-yes") : $("keyless")).focus();
}

async function release() {
  const what = order, before = presses; // a person may cancel, open the form for the other one, or stop
  const say = (text) => {
    if ($("release").open && order === what) $("release-says").textContent = text;
    else if (presses === before) $("hand-says").textContent = text;
  };
  $("release-says").textContent = what === "start" ? "starting …" : "releasing …";
  try {
    const answer = await send(`/${what}`, { keyless: $("keyless").checked, start: $("also").checked });
    if (answer.problem) return say(answer.problem);
    if (!answer.heard || answer.late.length)
      return say(answer.heard ? `not ${answer.released ? "started" : "released"}: ${answer.late.join(" ")}` : "no robot was heard");
    if (order === what) $("release").close();
    const silent = answer.silent.length ? `; NOT HEARD: ${answer.silent.join(" ")}` : "";
    say((what === "start" ? "started" : answer.started ? "released and started" : "released, not started") + silent);
  } catch {
    say("the map's server does not answer");
  }
}

$("stop").addEventListener("click", stop);
$("reset").addEventListener("click", () => openRelease("reset"));
$("start").addEventListener("click", () => openRelease("start"));
$("release-yes").addEventListener("click", release);
$("release-no").addEventListener("click", () => $("release").close());
$("help-open").addEventListener("click", () => { if ($("help").open) $("help").close(); else { $("help").show(); $("help-no").focus(); } });
$("help-no").addEventListener("click", () => $("help").close());

// ---------------------------------------------------------------- keys

const KEYS = {
  " ": () => $("play").click(), f: fit, F: fit, "+": () => closer(ZOOM), "=": () => closer(ZOOM), "-": () => closer(1 / ZOOM),
  "?": () => $("help-open").click(), ArrowLeft: () => step(-STEP_S), ArrowRight: () => step(STEP_S),
};

function step(seconds) { if (told) ask({ do: "seek", t: told.t + seconds }); }

addEventListener("keydown", (event) => {
  if (event.key === "Escape") { // whatever has the focus
    if (event.repeat) return;
    if (live || denied || full) stop(); else for (const id of ["release", "help"]) $(id).close();
    return;
  }
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  const arrow = event.key.startsWith("Arrow");
  // A key on a button, a box or a link belongs to that one; only the bare page has keys of its own.
  if (event.target !== document.body && event.target !== $("field") && !(arrow && event.target === $("scrub"))) return;
  const act = KEYS[event.key];
  if (!act) return;
  event.preventDefault();
  act();
});

// Another light: what is drawn gets its colours. The page is not loaded again: STOP, an open dialog, the time
// and the place that a person looks at stay.
matchMedia("(prefers-color-scheme: light)").addEventListener("change", () => { field.recolour(); dirty = true; });
addEventListener("hashchange", () => { if (location.hash.length > 1) location.reload(); });
takeToken();
connect();
requestAnimationFrame(picture);
