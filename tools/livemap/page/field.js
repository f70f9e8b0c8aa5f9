// Drawing: the ground that seldom changes on a canvas of its own, the robots over it in each picture.

let colours = ["#4cc2ff"]; // of robots; the server tells those of all our pictures
export function setColours(told) { colours = told; }
export const colourOf = (slot) => colours[slot % colours.length];
// Colours of the ground and of lines and words on it, for a dark room and for the sun.
const DARK = {
  ground: "#0e1316", field: "#18221d", hole: "#0a0e10", fence: "#7d8f86", free: "#31423a", open: "#2c3f4a", wall: "#dfe9ee", gate: "#e6edf0",
  mesh: "#1b2429", done: "#6d7b74", word: "#c6d3cc", line: "#ffffff", rim: "#0a0f12", faint: "#9fb0b8", block: "#8fa1aa", floor: "#182126", warn: "#ffd884", ask: "#ffb020", bad: "#ff6a70", load: "#4cc2ff",
};
const LIGHT = {
  ground: "#ffffff", field: "#eef3ea", hole: "#d5dad6", fence: "#4a5750", free: "#b9c6be", open: "#dce8ef", wall: "#27343b", gate: "#1a2226",
  mesh: "#e3e9ec", done: "#8a968f", word: "#33413a", line: "#101619", rim: "#ffffff", faint: "#5a6a72", block: "#5c6c75", floor: "#f1f4f5", warn: "#6b4700", ask: "#8a5200", bad: "#b00020", load: "#0b6ea8",
};
const sun = matchMedia("(prefers-color-scheme: light)");
export const paint = () => sun.matches ? LIGHT : DARK;
const BLOCK_UNITS = 40, GROUND_MS = 90, MARGIN_PX = 28;
const BOX = 1, DISC = 2; // shapes of things, as rows of sim/world/walls.py
const TAKEN_BACK = 0xFFFF; // the pickup of such an order, agent/delivery/task_registry.py
const UNKNOWN = 0, OPEN = 1; // values of cells, crdt/sighting.py

export class Field {
  constructor(canvas) {
    this.canvas = canvas;
    this.pen = canvas.getContext("2d", { alpha: false }); // opaque: cheaper to put on the screen
    this.ground = document.createElement("canvas");
    this.view = { x: 0, y: 0, scale: 4 }; // metres in the middle, pixels a metre
    this.layers = { path: true, velocity: true, orca: false, sections: true, trail: true, walls: false };
    this.chosen = null;
    this.fitted = false;
    this.moved = false; // by a person, who keeps what they look at
    this.scene = null;
    this.forget();
  }

  forget() {
    this.sections = new Map(); // id -> {phase, owner}
    this.done = new Map(); // id -> array of bits, one for each unit
    this.trails = new Map();
    this.known = new Map(); // cells of an explored map -> what was seen there
    this.transports = new Map(this.scene?.transports?.map(([task, from, to]) => [task, [from, to]])); // task -> cells
    this.stale = true;
    this.groundAt = 0;
    if (this.cells) this.cells.pen.clearRect(0, 0, this.cells.canvas.width, this.cells.canvas.height);
  }

  setScene(scene) {
    this.scene = scene;
    this.transports = new Map(scene?.transports?.map(([task, from, to]) => [task, [from, to]]));
    this.units = new Map();
    this.unitCount = 0;
    this.grid = this.cells = null;
    if (!scene) return;
    for (const section of scene.sections) {
      const lines = [];
      section.swaths.forEach((swath, k) => cut(swath, section.units[k], lines));
      this.units.set(section.id, lines);
      this.unitCount += lines.length;
    }
    if (scene.grid) this.grid = gridPicture(scene.grid);
    if (scene.cells) this.cells = layer(scene.cells);
    this.fitted = false;
    this.stale = true;
  }

  // ---------------------------------------------------------------- news

  take(told) {
    for (const [id, phase, owner] of told.sections ?? []) { this.sections.set(id, { phase, owner }); this.stale = true; }
    for (const [id, block, hex] of told.units ?? []) this.cover(id, block, BigInt("0x" + hex));
    for (const patch of told.cells ?? []) this.paint(patch);
    for (const [task, from, to] of told.transports ?? []) this.transports.set(task, [from, to]);
    if (told.things) this.things = told.things;
    for (const robot of told.robots.filter(isSomewhere)) {
      const trail = this.trails.get(robot.s) ?? [];
      const last = trail[trail.length - 1];
      if (!last || Math.hypot(robot.x - last[0], robot.y - last[1]) > 0.4) trail.push([robot.x, robot.y]);
      if (trail.length > 160) trail.shift();
      this.trails.set(robot.s, trail);
    }
  }

  cover(id, block, bits) {
    const done = this.done.get(id) ?? [];
    for (let k = 0; bits; k++, bits >>= 1n) if (bits & 1n) done[block * BLOCK_UNITS + k] = true;
    this.done.set(id, done);
    this.stale = true;
  }

  // Parcels that are or were carried, or wait for it: not those of orders that were taken back in time.
  get parcels() {
    const carried = (task) => this.sections.get(task)?.phase === "DONE" || (this.done.get(task) ?? [])[0];
    return [...this.transports].filter(([task, [from]]) => from !== TAKEN_BACK || carried(task));
  }

  // How many parcels were delivered, and how many there are.
  get delivered() {
    const done = this.parcels.filter(([task]) => this.sections.get(task)?.phase === "DONE");
    return [done.length, this.parcels.length];
  }

  get workDone() {
    if (this.isWarehouse) { const [done, all] = this.delivered; return all ? done / all : null; }
    const cells = this.scene?.cells;
    if (cells) return this.known.size / (cells.rows * cells.columns);
    let count = 0;
    for (const done of this.done.values()) for (const each of done) if (each) count++;
    return this.unitCount ? count / this.unitCount : null;
  }

  get isWarehouse() { return Boolean(this.scene?.bays); }

  // Metres of the middle of a cell of the floor; cells are counted without the border of walls.
  cellAt(cell) {
    const { columns, cell_m } = this.scene.grid, wide = columns - 2;
    return [((cell % wide) + 0.5) * cell_m, (Math.floor(cell / wide) + 0.5) * cell_m];
  }

  paint([row, column, ...values]) {
    const { pen, canvas } = this.cells;
    for (let k = 0; k < 16; k++) {
      const value = values[k];
      if (value === UNKNOWN) continue;
      this.known.set((row + (k >> 2)) * canvas.width + column + (k % 4), value);
      pen.fillStyle = value === OPEN ? paint().open : paint().wall;
      pen.fillRect(column + (k % 4), canvas.height - 1 - (row + (k >> 2)), 1, 1);
    }
    this.stale = true;
  }

  // In another light; all that was told stays.
  recolour() {
    if (this.grid) this.grid = gridPicture(this.scene.grid);
    for (const [cell, value] of this.known) {
      const { pen, canvas } = this.cells;
      pen.fillStyle = value === OPEN ? paint().open : paint().wall;
      pen.fillRect(cell % canvas.width, canvas.height - 1 - Math.floor(cell / canvas.width), 1, 1);
    }
    this.stale = true; this.groundAt = 0;
  }

  // ---------------------------------------------------------------- looking

  // All of the field and of the robots, between what lies over the map's edges (pixels).
  fit(robots = [], { top = 0, left = 0, bottom = 0 } = {}) {
    const points = [...(this.scene?.rings ?? []).flat(), ...robots.filter(isSomewhere).map((r) => [r.x, r.y])];
    const grid = this.scene?.grid;
    if (grid) points.push(grid.origin, [grid.origin[0] + grid.columns * grid.cell_m, grid.origin[1] + grid.rows * grid.cell_m]);
    if (!points.length) return;
    const xs = points.map((p) => p[0]), ys = points.map((p) => p[1]);
    const [west, east, south, north] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    const wide = Math.max(east - west, 3), high = Math.max(north - south, 3);
    const width = this.canvas.clientWidth - left - 2 * MARGIN_PX, height = this.canvas.clientHeight - top - bottom - 2 * MARGIN_PX;
    const scale = Math.max(Math.min(width / wide, height / high), 0.05);
    this.view = { x: (west + east) / 2 - left / 2 / scale, y: (south + north) / 2 + (top - bottom) / 2 / scale, scale };
    this.moved = false;
    this.fitted = this.stale = true;
  }

  zoom(factor, atX, atY) {
    const [x, y] = this.toField(atX, atY), view = this.view;
    view.scale = Math.min(Math.max(view.scale * factor, 0.05), 400);
    const [x2, y2] = this.toField(atX, atY);
    view.x += x - x2; view.y += y - y2;
    this.stale = this.moved = true; this.groundAt = 0;
  }

  pan(dx, dy) {
    this.view.x -= dx / this.view.scale; this.view.y += dy / this.view.scale;
    this.stale = this.moved = true; this.groundAt = 0;
  }

  toField(px, py) {
    const { x, y, scale } = this.view;
    return [x + (px - this.canvas.clientWidth / 2) / scale, y - (py - this.canvas.clientHeight / 2) / scale];
  }

  toScreen(x, y) {
    const view = this.view;
    return [this.canvas.clientWidth / 2 + (x - view.x) * view.scale, this.canvas.clientHeight / 2 - (y - view.y) * view.scale];
  }

  at(px, py, robots) {
    let best = null, nearest = 26;
    for (const robot of robots.filter(isSomewhere)) {
      const [x, y] = this.toScreen(robot.x, robot.y), distance = Math.hypot(x - px, y - py);
      if (distance < nearest) { nearest = distance; best = robot.s; }
    }
    return best;
  }

  // The section whose swath is nearest, within half a width or a finger's breadth.
  sectionAt(px, py) {
    if (!this.layers.sections) return null;
    const at = this.toField(px, py), reach = Math.max((this.scene?.width_m ?? 0) / 2, 10 / this.view.scale);
    let best = null, nearest = reach;
    for (const section of this.scene?.sections ?? [])
      for (const swath of section.swaths)
        for (let k = 1; k < swath.length; k++) {
          const far = away(at, swath[k - 1], swath[k]);
          if (far < nearest) { nearest = far; best = section.id; }
        }
    return best;
  }

  // Latitude and longitude of a place, degrees; null where the scene is nowhere on earth.
  earth([x, y]) {
    if (!this.scene?.earth) return null;
    const [lat, lon] = this.scene.earth, f = lat * Math.PI / 180;
    const north = 111132.92 - 559.82 * Math.cos(2 * f) + 1.175 * Math.cos(4 * f); // m for a degree
    const east = 111412.84 * Math.cos(f) - 93.5 * Math.cos(3 * f);
    return [lat + y / north, lon + x / east];
  }

  // ---------------------------------------------------------------- drawing

  draw(told) {
    const { canvas, pen } = this, dense = window.devicePixelRatio || 1;
    const width = Math.round(canvas.clientWidth * dense), height = Math.round(canvas.clientHeight * dense);
    if (canvas.width !== width || canvas.height !== height) {
      for (const each of [canvas, this.ground]) { each.width = width; each.height = height; }
      this.stale = true; this.groundAt = 0;
    }
    if (!width || !height) return; // banners have all the room; a canvas without a size cannot be drawn
    const now = performance.now();
    if (this.stale && now - this.groundAt > GROUND_MS) {
      this.groundAt = now; this.stale = false;
      const under = this.ground.getContext("2d");
      under.setTransform(dense, 0, 0, dense, 0, 0);
      this.drawGround(under);
    }
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.drawImage(this.ground, 0, 0);
    pen.setTransform(dense, 0, 0, dense, 0, 0);
    this.drawThings(pen);
    if (told && this.isWarehouse) this.drawParcels(pen, told);
    if (told) this.drawRobots(pen, told);
  }

  trace(pen, points, close) {
    points.forEach(([x, y], k) => { const [a, b] = this.toScreen(x, y); if (k) pen.lineTo(a, b); else pen.moveTo(a, b); });
    if (close) pen.closePath();
  }

  drawGround(pen) {
    const scene = this.scene, scale = this.view.scale;
    pen.fillStyle = paint().ground;
    pen.fillRect(0, 0, this.canvas.clientWidth, this.canvas.clientHeight);
    pen.lineJoin = pen.lineCap = "round";
    if (!scene) { this.drawMesh(pen); return; }
    const rings = scene.cells && !this.layers.walls ? scene.rings.slice(0, 1) : scene.rings; // what nobody has seen yet
    rings.forEach((ring, k) => {
      pen.beginPath(); this.trace(pen, ring, true);
      pen.fillStyle = k ? paint().hole : paint().field; pen.fill();
    });
    for (const [picture, from] of [[this.grid, scene.grid], [this.cells, scene.cells]]) {
      if (!picture) continue;
      const [x, y] = this.toScreen(from.origin[0], from.origin[1] + from.rows * from.cell_m);
      pen.imageSmoothingEnabled = false;
      pen.drawImage(picture.canvas, x, y, from.columns * from.cell_m * scale, from.rows * from.cell_m * scale);
    }
    if (this.layers.sections) this.drawSections(pen);
    pen.strokeStyle = paint().fence; pen.lineWidth = 1.6;
    for (const ring of rings) { pen.beginPath(); this.trace(pen, ring, true); pen.stroke(); }
    for (const bay of scene.bays ?? []) charger(pen, ...this.toScreen(...bay));
    for (const [slot, gx, gy] of scene.goals ?? []) {
      const [x, y] = this.toScreen(gx, gy);
      pen.strokeStyle = colourOf(slot); pen.lineWidth = 2;
      pen.strokeRect(x - 5, y - 5, 10, 10);
    }
    if (scene.gate) {
      const [x, y] = this.toScreen(...scene.gate);
      pen.fillStyle = paint().gate; pen.beginPath();
      pen.moveTo(x, y - 8); pen.lineTo(x + 7, y + 6); pen.lineTo(x - 7, y + 6); pen.fill();
    }
  }

  drawMesh(pen) {
    pen.strokeStyle = paint().mesh; pen.lineWidth = 1; pen.beginPath();
    const step = 10, [west, north] = this.toField(0, 0), [east, south] = this.toField(this.canvas.clientWidth, this.canvas.clientHeight);
    if ((east - west) / step > 200) return;
    for (let x = Math.ceil(west / step) * step; x < east; x += step) this.trace(pen, [[x, south], [x, north]]);
    for (let y = Math.ceil(south / step) * step; y < north; y += step) this.trace(pen, [[west, y], [east, y]]);
    pen.stroke();
  }

  drawSections(pen) {
    const wide = Math.max(this.scene.width_m * this.view.scale * 0.92, 1.5);
    const bands = new Map(), lines = new Map();
    for (const section of this.scene.sections) {
      const { phase = "FREE", owner = null } = this.sections.get(section.id) ?? {};
      const units = this.units.get(section.id), done = this.done.get(section.id) ?? [];
      const band = owner === null ? -1 : owner;
      for (let k = 0; k < units.length; k++) if (done[k]) push(bands, band, units[k]);
      if (phase !== "DONE") for (const swath of section.swaths) push(lines, `${phase} ${owner ?? ""}`, swath);
    }
    pen.lineCap = "butt";
    for (const [owner, pieces] of bands) {
      pen.strokeStyle = owner < 0 ? paint().done : colourOf(owner); pen.lineWidth = wide; pen.globalAlpha = 0.42;
      pen.beginPath(); for (const piece of pieces) this.trace(pen, piece); pen.stroke();
    }
    pen.globalAlpha = 1;
    for (const [key, pieces] of lines) {
      const [phase, owner] = key.split(" ");
      const free = phase === "FREE" || owner === "";
      pen.strokeStyle = free ? paint().free : colourOf(Number(owner));
      pen.lineWidth = phase === "STARTED" ? 1.8 : 1.1;
      pen.setLineDash(phase === "CLAIMED" ? [7, 5] : []);
      pen.beginPath(); for (const piece of pieces) this.trace(pen, piece); pen.stroke();
    }
    pen.setLineDash([]);
    if (this.view.scale > 5) this.drawNames(pen);
    pen.lineCap = "round";
  }

  drawNames(pen) {
    pen.font = "11px system-ui, sans-serif"; pen.textAlign = "center"; pen.textBaseline = "middle"; pen.fillStyle = paint().word;
    for (const section of this.scene.sections) {
      const units = this.units.get(section.id), line = units[units.length >> 1];
      if (line) pen.fillText(`S${section.id}`, ...this.toScreen(...line[0]));
    }
  }

  drawThings(pen) {
    const scale = this.view.scale;
    pen.fillStyle = "#ff9d3c"; pen.strokeStyle = "#2a1600"; pen.lineWidth = 2;
    for (const [shape, x, y, halfX, halfY, cos, sin] of this.things ?? []) {
      pen.beginPath();
      if (shape === DISC) pen.arc(...this.toScreen(x, y), Math.max(halfX * scale, 3), 0, 2 * Math.PI);
      else if (shape === BOX) this.trace(pen, [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) =>
        [x + a * halfX * cos - b * halfY * sin, y + a * halfX * sin + b * halfY * cos]), true);
      pen.fill(); pen.stroke();
    }
  }

  // A parcel waits at its pickup, rides on its robot, and is small where it was delivered.
  drawParcels(pen, told) {
    const where = new Map(told.robots.filter(isSomewhere).map((r) => [r.s, r]));
    for (const [task, [said, to]] of this.parcels) {
      const from = said === TAKEN_BACK ? to : said;
      const { phase = "FREE", owner = null } = this.sections.get(task) ?? {}, aboard = (this.done.get(task) ?? [])[0];
      const carrier = aboard && phase !== "DONE" ? where.get(owner) : null;
      const [x, y] = this.toScreen(...(carrier ? [carrier.x, carrier.y] : this.cellAt(phase === "DONE" ? to : from)));
      const half = phase === "DONE" ? 3 : 6, up = carrier ? 16 : 0;
      pen.fillStyle = phase === "DONE" ? paint().done : owner === null || phase === "FREE" ? "#d8b26a" : colourOf(owner);
      pen.strokeStyle = paint().rim; pen.lineWidth = 1.5;
      pen.fillRect(x - half, y - half - up, 2 * half, 2 * half); pen.strokeRect(x - half, y - half - up, 2 * half, 2 * half);
    }
  }

  drawRobots(pen, told) {
    const robots = told.robots.filter((r) => !r.left && isSomewhere(r)), where = new Map(robots.map((r) => [r.s, r]));
    const radius = Math.max((this.scene?.radius_m ?? 0.5) * this.view.scale, 10);
    pen.lineCap = pen.lineJoin = "round";
    if (this.layers.trail) this.drawTrails(pen, robots);
    if (told.islands.length > 1) this.drawIslands(pen, told.islands, where, radius);
    for (const robot of robots) {
      const chosen = robot.s === this.chosen;
      if (this.layers.path && robot.path?.length) this.drawPath(pen, robot, chosen);
      if ((this.layers.orca || chosen) && robot.near) this.drawNear(pen, robot, where, radius, chosen);
      for (const [x, y] of robot.strange ?? []) cross(pen, ...this.toScreen(x, y), "#ff9d3c");
    }
    const standing = told.stop.stopped.length > 0;
    for (const robot of robots) this.drawBody(pen, robot, radius, standing);
  }

  drawTrails(pen, robots) {
    pen.lineWidth = 2;
    for (const robot of robots) {
      const trail = this.trails.get(robot.s) ?? [], parts = 8;
      for (let k = 0; k < parts; k++) {
        const from = Math.floor(trail.length * k / parts), to = Math.floor(trail.length * (k + 1) / parts) + 1;
        pen.globalAlpha = 0.75 * (k + 1) / parts; pen.strokeStyle = colourOf(robot.s);
        pen.beginPath(); this.trace(pen, trail.slice(from, to)); pen.stroke();
      }
    }
    pen.globalAlpha = 1;
  }

  drawPath(pen, robot, chosen) {
    pen.strokeStyle = colourOf(robot.s); pen.globalAlpha = chosen ? 1 : 0.85; pen.lineWidth = chosen ? 3 : 1.8;
    pen.setLineDash([3, 6]);
    pen.beginPath(); this.trace(pen, [[robot.x, robot.y], ...robot.path]); pen.stroke();
    pen.setLineDash([]);
    const [x, y] = this.toScreen(...robot.path[robot.path.length - 1]);
    pen.beginPath(); pen.arc(x, y, 4, 0, 2 * Math.PI); pen.stroke();
    pen.globalAlpha = 1;
  }

  drawNear(pen, robot, where, radius, chosen) {
    const [x, y] = this.toScreen(robot.x, robot.y);
    pen.strokeStyle = chosen ? paint().line : paint().faint; pen.lineWidth = chosen ? 1.6 : 1; pen.globalAlpha = chosen ? 0.9 : 0.45;
    pen.setLineDash([2, 4]);
    for (const slot of robot.near) {
      const other = where.get(slot);
      if (!other) continue;
      const [a, b] = this.toScreen(other.x, other.y);
      pen.beginPath(); pen.moveTo(x, y); pen.lineTo(a, b); pen.stroke();
      if (chosen) { pen.beginPath(); pen.arc(a, b, radius + 5, 0, 2 * Math.PI); pen.stroke(); }
    }
    pen.setLineDash([]); pen.globalAlpha = 1;
  }

  drawIslands(pen, islands, where, radius) {
    islands.forEach((island, k) => {
      const tint = ["#ffb020", "#6ad1ff", "#d08bff", "#8dff9a"][k % 4];
      const here = island.filter((slot) => where.has(slot)).map((slot) => this.toScreen(where.get(slot).x, where.get(slot).y));
      pen.strokeStyle = tint; pen.lineWidth = 3; pen.globalAlpha = 0.35;
      pen.beginPath();
      for (let i = 1; i < here.length; i++) { pen.moveTo(...here[i - 1]); pen.lineTo(...here[i]); }
      pen.stroke(); pen.globalAlpha = 1;
      for (const [x, y] of here) {
        pen.strokeStyle = tint; pen.lineWidth = 3;
        pen.beginPath(); pen.arc(x, y, radius + 6, 0, 2 * Math.PI); pen.stroke();
        label(pen, "ABCDEFGH"[k % 8], x + radius + 8, y - radius - 8, tint);
      }
    });
  }

  drawBody(pen, robot, radius, standing) {
    const [x, y] = this.toScreen(robot.x, robot.y), heading = robot.h ?? robot.c, chosen = robot.s === this.chosen;
    const dark = robot.silent || robot.state === "DISCONNECTED";
    if (this.layers.velocity && !dark) {
      const vx = robot.vx ?? robot.v * Math.cos(robot.c), vy = robot.vy ?? robot.v * Math.sin(robot.c);
      const long = Math.hypot(vx, vy);
      if (long > 0.05) arrow(pen, x, y, vx / long, -vy / long, radius + 6 + long * 14);
    }
    pen.fillStyle = dark ? "#5b666c" : colourOf(robot.s);
    pen.strokeStyle = robot.stopped ? "#f5222d" : chosen ? paint().line : paint().rim;
    pen.lineWidth = robot.stopped ? 5 : chosen ? 3 : 2;
    pen.beginPath(); pen.arc(x, y, radius, 0, 2 * Math.PI); pen.fill(); pen.stroke();
    if (this.scene?.front !== false) this.drawNose(pen, robot, x, y, radius, heading);
    pen.fillStyle = dark ? "#fff" : "#081014"; pen.font = `700 ${Math.max(11, Math.min(radius * 1.1, 26))}px system-ui, sans-serif`;
    pen.textAlign = "center"; pen.textBaseline = "middle";
    pen.fillText(String(robot.s), x, y + 0.5);
    if (robot.silent) label(pen, "silent", x, y + radius + 14, paint().warn);
    else if (robot.asks) {
      const [matter, ax, ay] = robot.asks;
      label(pen, "?", ...this.toScreen(ax, ay), paint().ask, 22);
      label(pen, matter === "ASKING" ? "asks what to do" : "waits", x, y + radius + 14, paint().ask);
    } else if (standing && !robot.stopped) label(pen, "NOT STOPPED", x, y + radius + 14, paint().bad);
  }

  // So that the heading of a machine with a front is seen where it stands.
  drawNose(pen, robot, x, y, radius, heading) {
    pen.save();
    pen.translate(x, y); pen.rotate(-heading);
    pen.beginPath(); pen.moveTo(radius * 1.62, 0); pen.lineTo(radius * 0.9, -radius * 0.62); pen.lineTo(radius * 0.9, radius * 0.62); pen.closePath();
    pen.fillStyle = robot.stopped ? "#f5222d" : paint().line; pen.fill(); pen.lineWidth = 1.5; pen.strokeStyle = paint().rim; pen.stroke();
    pen.restore();
  }
}

// A robot that has told no place is in the table, and not on the map.
function isSomewhere(robot) { return !robot.nowhere; }

// Pixels or metres from a point to a piece of a line.
function away([x, y], [ax, ay], [bx, by]) {
  const dx = bx - ax, dy = by - ay, share = Math.max(0, Math.min(1, ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy || 1)));
  return Math.hypot(x - ax - share * dx, y - ay - share * dy);
}

function charger(pen, x, y) {
  pen.strokeStyle = paint().gate; pen.lineWidth = 2; pen.strokeRect(x - 9, y - 9, 18, 18);
  pen.fillStyle = paint().warn; pen.beginPath();
  for (const [a, b] of [[2, -7], [-4, 1], [0, 1], [-2, 7], [4, -1], [0, -1]]) pen.lineTo(x + a, y + b);
  pen.fill();
}

function push(map, key, value) { const list = map.get(key); if (list) list.push(value); else map.set(key, [value]); }

// A polyline in `count` pieces of equal length: the units of progress.
function cut(line, count, into) {
  const ends = [0];
  for (let k = 1; k < line.length; k++) ends.push(ends[k - 1] + Math.hypot(line[k][0] - line[k - 1][0], line[k][1] - line[k - 1][1]));
  const total = ends[ends.length - 1];
  let k = 1;
  const along = (at) => {
    while (k < line.length - 1 && ends[k] < at) k++;
    const share = (at - ends[k - 1]) / Math.max(ends[k] - ends[k - 1], 1e-9);
    return [line[k - 1][0] + (line[k][0] - line[k - 1][0]) * share, line[k - 1][1] + (line[k][1] - line[k - 1][1]) * share];
  };
  let from = line[0];
  for (let unit = 1; unit <= count; unit++) {
    const first = k, at = total * unit / count, to = along(at);
    into.push([from, ...line.slice(first, k), to]);
    from = to;
  }
}

function layer({ rows, columns }) {
  const canvas = document.createElement("canvas");
  canvas.width = columns; canvas.height = rows;
  return { canvas, pen: canvas.getContext("2d") };
}

function gridPicture(grid) {
  const picture = layer(grid), bits = atob(grid.walls);
  for (let k = 0; k < grid.rows * grid.columns; k++) {
    const wall = bits.charCodeAt(k >> 3) & (128 >> (k & 7));
    picture.pen.fillStyle = wall ? paint().block : paint().floor;
    picture.pen.fillRect(k % grid.columns, grid.rows - 1 - Math.floor(k / grid.columns), 1, 1);
  }
  return picture;
}

function arrow(pen, x, y, ux, uy, long) {
  const ax = x + ux * long, ay = y + uy * long;
  pen.strokeStyle = pen.fillStyle = paint().line; pen.lineWidth = 2.2;
  pen.beginPath(); pen.moveTo(x, y); pen.lineTo(ax, ay); pen.stroke();
  pen.beginPath(); pen.moveTo(ax + ux * 7, ay + uy * 7); pen.lineTo(ax - uy * 4.5, ay + ux * 4.5); pen.lineTo(ax + uy * 4.5, ay - ux * 4.5); pen.fill();
}

function cross(pen, x, y, colour) {
  pen.strokeStyle = colour; pen.lineWidth = 2;
  pen.beginPath(); pen.moveTo(x - 4, y - 4); pen.lineTo(x + 4, y + 4); pen.moveTo(x + 4, y - 4); pen.lineTo(x - 4, y + 4); pen.stroke();
}

function label(pen, text, x, y, colour, size = 12) {
  pen.font = `600 ${size}px system-ui, sans-serif`; pen.textAlign = "center"; pen.textBaseline = "middle";
  pen.lineWidth = 4; pen.strokeStyle = paint().rim; pen.strokeText(text, x, y);
  pen.fillStyle = colour; pen.fillText(text, x, y);
}
