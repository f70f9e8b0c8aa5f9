// Everything that is text: the header, the fleet's table, one robot, the line of time.

import { colourOf, paint } from "./field.js";

export const $ = (id) => document.getElementById(id);
const STATES = ["DISCONNECTED", "IDLE", "SYNCHRONIZING", "WORKING", "EMERGENCY_STOP"];
const words = (name) => name.toLowerCase().replaceAll("_", " ");
const EVENTS_SHOWN = 100;
const MARKS = { stop: "#f5222d", reset: "#4fd17c", back: "#4fd17c", other: "#ffb020" };
const PACE_S = 60; // over which the pace of the work is measured
const HISTORY = 120; // looks at the load of the bus, two a second

function node(tag, text, kind) {
  const made = document.createElement(tag);
  if (text !== undefined) made.textContent = text;
  if (kind) made.className = kind;
  return made;
}

export function clock(seconds) {
  const s = Math.floor(Math.max(0, seconds) * 10) / 10, h = Math.floor(s / 3600), m = Math.floor((s % 3600) / 60);
  const rest = (s % 60).toFixed(1).padStart(4, "0");
  return h ? `${h}:${String(m).padStart(2, "0")}:${rest}` : `${m}:${rest}`;
}

const stateOf = (robot) => robot.silent ? "silent" : robot.left ? "left" : robot.state;

// A screen reader reads a live region again whenever its text is set, also to the same words.
export function set(place, text) { if (place.textContent !== text) place.textContent = text; }

// Why a robot stands, in a few words; empty: it goes, or nobody knows.
function why(robot) {
  if (robot.left) return "";
  if (robot.silent) return `not heard for ${clock(robot.age)}`;
  if (robot.stopped) return "stopped: release it";
  if (robot.asks) return robot.asks[0] === "ASKING" ? "asks what to do" : "waits for an operator";
  if (robot.stands?.length) return robot.stands[0]; // said on the bus, with what a person can do
  const held = (robot.holds ?? []).map(words);
  if (held.length) return `holds: ${held.join(", ")}`;
  return robot.started ? "" : "not started";
}

export class Side {
  constructor(choose, askWhy) {
    this.choose = choose; this.askWhy = askWhy;
    this.rows = new Map();
    this.loads = [];
    this.paces = []; // time and share of the work, over the last minute
    this.owned = new Map(); // slot -> sections it has begun
    this.old = false; // nothing that is shown is of now
  }

  forget() { this.loads = []; this.paces = []; this.owned.clear(); this.sections = new Map(); }

  take(told) {
    this.sections ??= new Map();
    for (const [id, phase, owner] of told.sections ?? []) this.sections.set(id, { phase, owner });
    if (told.sections) {
      this.owned.clear();
      for (const [id, { phase, owner }] of this.sections)
        if (owner !== null && (phase === "STARTED" || phase === "CLAIMED")) {
          const text = phase === "STARTED" ? `S${id}` : `(S${id})`;
          this.owned.set(owner, this.owned.has(owner) ? `${this.owned.get(owner)} ${text}` : text);
        }
    }
  }

  show(told, field) {
    this.showStates(told);
    this.showFleet(told, field.chosen);
    const work = field.workDone;
    $("work-bar").style.width = `${100 * (work ?? 0)}%`;
    const [delivered, parcels] = field.isWarehouse ? field.delivered : [0, 0];
    $("work").textContent = work === null ? "–" : parcels ? `${delivered} of ${parcels}` : `${(100 * work).toFixed(1)} %`;
    const left = this.old ? null : this.remaining(told.t, work);
    set($("eta"), left === null ? "" : `${clock(left).split(".")[0]} left`);
    $("work-meter").setAttribute("aria-valuenow", (100 * (work ?? 0)).toFixed(0));
    $("load").textContent = this.old ? "–" : `${(100 * told.load).toFixed(0)} %`;
    $("load-line").setAttribute("aria-valuenow", (100 * told.load).toFixed(0));
    this.loads.push(told.load);
    if (this.loads.length > HISTORY) this.loads.shift();
    this.drawLoad();
    const rows = Object.entries(told.frames).map(([kind, count]) => {
      const row = node("tr");
      row.append(node("td", words(kind)), node("td", String(count), "number"));
      return row;
    });
    const all = node("tr");
    all.append(node("td", "all frames"), node("td", String(told.total), "number"));
    $("kinds").replaceChildren(...rows, all);
  }

  showStates(told) {
    const counts = new Map();
    for (const robot of told.robots) {
      const state = stateOf(robot);
      counts.set(state, (counts.get(state) ?? 0) + 1);
    }
    $("states").replaceChildren(...[...counts].map(([state, count]) => node("span", `${count} ${words(state)}`, `pill ${state}`)));
  }

  showFleet(told, chosen) {
    const body = $("fleet").tBodies[0];
    for (const robot of told.robots) {
      let row = this.rows.get(robot.s);
      if (!row) {
        row = node("tr");
        for (let k = 0; k < 5; k++) row.append(node("td"));
        row.cells[0].append(node("span", undefined, "dot"));
        row.cells[0].firstChild.style.background = colourOf(robot.s);
        row.cells[1].append(node("button", String(robot.s)));
        row.cells[1].firstChild.type = "button";
        row.cells[1].firstChild.setAttribute("aria-label", `robot ${robot.s}: details`);
        row.cells[2].append(node("span"), node("span", undefined, "why"));
        row.cells[3].className = "number";
        row.addEventListener("click", () => this.choose(robot.s));
        row.dataset.slot = robot.s;
        this.rows.set(robot.s, row);
        const after = [...body.rows].find((other) => Number(other.dataset.slot) > robot.s);
        body.insertBefore(row, after ?? null);
      }
      const state = stateOf(robot);
      row.className = robot.s === chosen ? "chosen" : "";
      row.cells[1].firstChild.setAttribute("aria-pressed", String(robot.s === chosen));
      row.cells[2].firstChild.textContent = words(state);
      row.cells[2].firstChild.className = `pill ${state}`;
      set(row.cells[2].lastChild, why(robot));
      row.cells[3].textContent = this.old || robot.silent || robot.left ? "–" : robot.v.toFixed(1);
      this.showWork(row.cells[4], robot);
    }
    for (const [slot, row] of this.rows)
      if (!told.robots.some((robot) => robot.s === slot)) { row.remove(); this.rows.delete(slot); }
  }

  // What a robot has: its sections as buttons that say why, or its itinerary and battery.
  showWork(cell, robot) {
    const text = robot.queue ? `${robot.queue.join(" ")} ${Math.round(100 * robot.battery)}\u00a0%` : this.owned.get(robot.s) ?? "";
    if (cell.dataset.text === text) return; // a button that has the focus stays
    cell.dataset.text = text;
    const pieces = text.split(" ").map((word) => {
      const section = /^\(?S(\d+)\)?$/.exec(word);
      if (!section) return `${word} `;
      const button = node("button", word, "section");
      button.type = "button"; button.setAttribute("aria-label", `why ${word}`);
      button.addEventListener("click", (event) => { event.stopPropagation(); this.askWhy(Number(section[1])); });
      return button;
    });
    cell.replaceChildren(...pieces);
  }

  // How a section came to its robot.
  showWhy(told) {
    $("why").hidden = !told;
    if (!told) return;
    $("why-name").textContent = `section ${told.section}`;
    $("why-now").textContent = told.owner === null ? "free: no robot has it" : `${words(told.phase)} by robot ${told.owner}`;
    $("why-steps").replaceChildren(...told.steps.map(([t, text, because]) => {
      const line = node("li");
      line.append(node("span", clock(t - this.from), "when"), node("span", ` ${text}`));
      for (const cause of because) line.append(node("span", `because ${cause}`, "because"));
      return line;
    }));
    $("why").scrollIntoView({ block: "nearest" });
  }

  // Seconds until all is done, at the pace of the last minute; null: nobody can say.
  remaining(t, work) {
    if (work === null) return null;
    const first = this.paces[0];
    if (first && t < first[0]) this.paces = [];
    this.paces.push([t, work]);
    while (this.paces.length > 2 && t - this.paces[1][0] > PACE_S) this.paces.shift();
    const [t0, work0] = this.paces[0];
    return work >= 1 || t - t0 < 5 || work <= work0 ? null : (1 - work) * (t - t0) / (work - work0);
  }

  drawLoad() {
    const canvas = $("load-line"), pen = canvas.getContext("2d"), high = canvas.height;
    pen.clearRect(0, 0, canvas.width, high);
    pen.fillStyle = paint().mesh; pen.fillRect(0, 0, canvas.width, high);
    pen.strokeStyle = "#ffb020"; pen.setLineDash([2, 3]);
    pen.beginPath(); pen.moveTo(0, high * 0.3); pen.lineTo(canvas.width, high * 0.3); pen.stroke(); pen.setLineDash([]);
    pen.strokeStyle = paint().load; pen.lineWidth = 1.5; pen.beginPath();
    this.loads.forEach((load, k) => pen.lineTo(k * canvas.width / HISTORY, high - 1 - Math.min(load, 1) * (high - 2)));
    pen.stroke();
  }

  showOne(robot, live) {
    $("one").hidden = !robot;
    if (!robot) return;
    const now = !robot.silent && !robot.left && !this.old;
    $("one-name").textContent = `robot ${robot.slot}${now ? "" : ", as last heard"}`;
    $("machine").replaceChildren(...STATES.map((state) => {
      const current = state === robot.state;
      return node("li", words(state), `pill ${current ? (now ? `${state} now` : "was") : "no"}`);
    }));
    const facts = {
      stands: live?.stands?.join("; ") || (live && why(live)) || "no reason to",
      place: robot.x_m === null ? "not known" : `${robot.x_m.toFixed(1)}, ${robot.y_m.toFixed(1)} m`, speed: now ? `${robot.speed_m_s.toFixed(2)} m/s` : "–",
      sections: robot.sections.join(" ") || "none",
      hears: (live?.hears ?? robot.peers).filter((slot) => slot !== robot.slot).join(" ") || "nobody", address: robot.address, health: `${(100 * robot.health).toFixed(0)} %`,
      digest: robot.digest, clock: Object.entries(robot.clock).map(([slot, count]) => `${slot}:${count}`).join(" "),
    };
    $("facts").replaceChildren(...Object.entries(facts).flatMap(([name, value]) => [node("dt", name), node("dd", String(value))]));
    $("path").replaceChildren(...robot.transitions.slice().reverse().map((step) =>
      node("li", `${clock(step.t_s - this.from)}  ${words(step.from)} → ${words(step.to)}`)));
  }

  showStop(stop, robots) {
    const standing = stop.stopped.length > 0;
    document.querySelector("main").classList.toggle("stopped", standing);
    $("stopped").hidden = !standing;
    if (!standing) return;
    const not = [["NOT STOPPED", stop.moving], ["NOT HEARD", stop.silent]].filter(([, slots]) => slots.length);
    const who = not.map(([what, slots]) => `${what}: ${slots.join(" ")}`).join(" · ");
    set($("stopped-who"), who || `all ${stop.stopped.length} robots stand`);
    // The first stop that holds: a flood of forged ones, which come later, does not change what is said.
    const first = stop.latched[0], more = stop.latched.length - 1 + stop.more;
    const by = !first ? "" : first.slot >= 128 ? "by an operator's device" : `by robot ${first.slot}`;
    const others = more > 0 ? `, and ${more} more` : "";
    set($("stopped-why"), first ? `pressed ${by}${first.reason ? `: ${words(first.reason)}` : ""}${others}` : "");
  }

  showSplit(islands) {
    $("split").hidden = islands.length < 2;
    set($("split-who"), islands.map((island, k) => `${"ABCDEFGH"[k % 8]}: ${island.join(" ")}`).join("   |   "));
  }

  // What happened, newest first; each line is a button that goes there.
  showEvents(events, go) {
    const shown = events.slice(-EVENTS_SHOWN).reverse(), list = $("events");
    const held = list.contains(document.activeElement) ? document.activeElement.textContent : null;
    $("events-none").hidden = shown.length > 0;
    list.replaceChildren(...shown.map(([t, kind, text]) => {
      const line = node("li"), button = node("button");
      button.type = "button"; button.dataset.t = t; button.dataset.kind = kind;
      button.append(node("span", clock(t - this.from), "when"), node("span", text));
      button.addEventListener("click", () => go(t));
      line.append(button);
      return line;
    }));
    // A person who goes through the list by keyboard stays at their line.
    if (held !== null) [...list.querySelectorAll("button")].find((each) => each.textContent === held)?.focus();
  }

  drawMarks(told, events) {
    const canvas = $("marks"), pen = canvas.getContext("2d"), span = Math.max(told.until - told.from, 1e-6);
    canvas.width = canvas.clientWidth;
    pen.clearRect(0, 0, canvas.width, canvas.height);
    for (const [t, kind] of events) {
      pen.fillStyle = MARKS[kind] ?? MARKS.other;
      const x = 8 + (canvas.width - 16) * (t - told.from) / span;
      pen.beginPath(); pen.moveTo(x, 12); pen.lineTo(x - 5, 1); pen.lineTo(x + 5, 1); pen.fill();
    }
  }
}
