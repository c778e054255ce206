"use strict";
// A mission in WebGL 2: four programs (points, lines, the rock, photographs), one camera that all missions share.
const STEP_M = 0.00025, RAMP = ["#2f7fd0", "#7cc4f2", "#f4f1e4", "#f2b233", "#e0531a"];
const BROWN = "#a0522d", GREY = "#9aa4ae", WHITE = "#ffffff", BLUE = "#57b3e8", ORANGE = "#e69e00", RED = "#e64033";
const missions = JSON.parse(document.getElementById("data").textContent);
const HALF_FIELD_RAD = 0.45; // half the vertical field of view
const PICK_PX = 24; // a click nearer to a camera than this picks it
const camera = { az: -1.0, el: 0.45, far: 6.8, at: [...missions[0].target] };
const $ = id => document.getElementById(id);
const el = (tag, html = "", cls = "") => Object.assign(document.createElement(tag), { innerHTML: html, className: cls });
const safe = text => String(text).replace(/[&<>"]/g, c => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[c]);
const rgb = hex => [1, 3, 5].map(i => parseInt(hex.slice(i, i + 2), 16) / 255);
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
const unpack = (text, Kind) => new Kind(bytes(text).buffer);
const metres = (text, origin) => Float32Array.from(unpack(text, Int16Array), (v, i) => origin[i % 3] + STEP_M * v);

const layers = { rock: missions[0].surface, missing: "missing surface", sparse: "sparse cloud", dense: "dense cloud (at the end)", cameras: "cameras", photographs: "photographs", pool: "candidate pool", path: "path" };
const shown = Object.fromEntries(Object.keys(layers).map(key => [key, true]));
let step = 0;

// Matrices are columns first, as WebGL wants them.
const sub = (a, b) => a.map((v, i) => v - b[i]), dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const add = (a, b, s = 1) => a.map((v, i) => v + s * b[i]);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = a => { const n = Math.hypot(...a) || 1; return a.map(v => v / n); };
const eye = () => { const c = Math.cos(camera.el); return add(camera.at, [c * Math.cos(camera.az), c * Math.sin(camera.az), Math.sin(camera.el)], camera.far); };
function axes(from, to) {
  const forward = unit(sub(to, from));
  let right = cross(forward, [0, 0, 1]);
  right = unit(Math.hypot(...right) < 1e-6 ? [1, 0, 0] : right);
  return [right, cross(right, forward), forward];
}
function matrix(aspect) {
  const [r, u, f] = axes(eye(), camera.at), e = eye(), near = 0.03, far = 200, s = Math.min(1, aspect) / Math.tan(HALF_FIELD_RAD);
  const rows = [[...r, -dot(r, e)], [...u, -dot(u, e)], [...f, -dot(f, e)]], [x, y, z] = [s / aspect, s, (far + near) / (far - near)];
  const clip = [rows[0].map(v => x * v), rows[1].map(v => y * v), rows[2].map((v, i) => z * v - (i === 3 ? 2 * far * near / (far - near) : 0)), rows[2]];
  return new Float32Array([0, 1, 2, 3].flatMap(column => clip.map(row => row[column])));
}

const HEAD = "#version 300 es\nprecision highp float;\n";
const SHADERS = {
  points: [`in vec3 p; in float e; uniform mat4 m; uniform float size, px; uniform vec3 ramp[5]; out vec3 col;
    void main() { gl_Position = m * vec4(p, 1.0); gl_PointSize = clamp(size * px / gl_Position.w, 1.5, 40.0);
      float t = clamp(e / 64.0, 0.0, 1.0) * 4.0; int i = min(int(t), 3); col = mix(ramp[i], ramp[i + 1], t - float(i)); }`,
    `in vec3 col; out vec4 o; void main() { vec2 d = gl_PointCoord - 0.5; if (dot(d, d) > 0.25) discard; o = vec4(col, 1); }`],
  lines: [`in vec3 p; uniform mat4 m; void main() { gl_Position = m * vec4(p, 1.0); }`, `uniform vec3 col; out vec4 o; void main() { o = vec4(col, 1); }`],
  photograph: [`in vec3 p; uniform mat4 m; out vec2 at; void main() { gl_Position = m * vec4(p, 1.0); at = vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1); }`,
    `in vec2 at; out vec4 o; uniform sampler2D s; void main() { o = texture(s, at); }`],
  rock: [`in vec3 p; uniform mat4 m; out vec3 w; void main() { w = p; gl_Position = m * vec4(p, 1.0); }`,
    `in vec3 w; out vec4 o; uniform vec3 eye; void main() { vec3 n = normalize(cross(dFdx(w), dFdy(w))); float s = abs(dot(n, normalize(eye - w))); o = vec4(vec3(0.42, 0.43, 0.45) * (0.35 + 0.65 * s), 1); }`],
};

class Space {
  constructor(mission, canvas) {
    this.mission = mission; this.canvas = canvas;
    const gl = this.gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    if (!gl) throw new Error("WebGL 2 is switched off in this browser");
    this.programs = Object.fromEntries(Object.entries(SHADERS).map(([name, [v, f]]) => [name, this.program(HEAD + v, HEAD + f)]));
    gl.enable(gl.DEPTH_TEST);
    const cloud = c => c && { p: this.buffer(metres(c.p, mission.origin)), e: c.e && this.buffer(bytes(c.e)), n: bytes(c.p).length / 6 };
    this.models = mission.models.map(cloud); this.dense = cloud(mission.dense); this.missing = cloud(mission.missing);
    const faces = unpack(mission.mesh.f, Uint32Array);
    this.rock = { ...cloud(mission.mesh), f: this.buffer(faces, gl.ELEMENT_ARRAY_BUFFER), faces: faces.length };
    this.samples = unpack(mission.path, Float32Array); // time, east, north, up
    this.path = this.buffer(this.samples.filter((_, i) => i % 4));
    const [x, y] = mission.target, grid = [];
    for (let i = -4; i <= 4; i++) grid.push(x + i, y - 4, 0, x + i, y + 4, 0, x - 4, y + i, 0, x + 4, y + i, 0);
    this.grid = this.buffer(new Float32Array([...grid, x - 4, y - 4, 0, x - 3, y - 4, 0, x - 4, y - 4, 0, x - 4, y - 3, 0]));
    const corners = mission.views.map(view => this.corners(view));
    this.frusta = this.buffer(new Float32Array(corners.flatMap((c, i) => c.flatMap((corner, j) => [...mission.views[i].at, ...corner, ...corner, ...c[(j + 1) % 4]]))));
    this.quads = this.buffer(new Float32Array(corners.flatMap(([a, b, c, d]) => [...a, ...b, ...d, ...c])));
    this.photographs = mission.views.map(view => view.image && this.texture(view.image));
  }
  program(v, f) {
    const gl = this.gl, p = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, v], [gl.FRAGMENT_SHADER, f]]) { const s = gl.createShader(kind); gl.shaderSource(s, text); gl.compileShader(s); gl.attachShader(p, s); if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(s)); }
    gl.linkProgram(p); return p;
  }
  buffer(values, kind = this.gl.ARRAY_BUFFER) { const b = this.gl.createBuffer(); this.gl.bindBuffer(kind, b); this.gl.bufferData(kind, values, this.gl.STATIC_DRAW); return b; }
  corners({ at, axes: own }) { // of a photograph, from the upper left, clockwise
    const [w, h, f] = this.mission.camera, depth = 0.24, [r, u, forward] = own || axes(at, this.mission.target), mid = add(at, forward, depth);
    return [[-1, 1], [1, 1], [1, -1], [-1, -1]].map(([x, y]) => add(add(mid, r, x * depth * w / 2 / f), u, y * depth * h / 2 / f));
  }
  texture(jpeg) {
    const gl = this.gl, texture = gl.createTexture(), image = new Image();
    image.onload = () => { gl.bindTexture(gl.TEXTURE_2D, texture); gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image); gl.generateMipmap(gl.TEXTURE_2D); draw(); };
    image.src = "data:image/jpeg;base64," + jpeg; return texture;
  }
  use(name, m, p) {
    const gl = this.gl, program = this.programs[name], at = gl.getAttribLocation(program, "p");
    gl.useProgram(program); gl.uniformMatrix4fv(gl.getUniformLocation(program, "m"), false, m);
    gl.bindBuffer(gl.ARRAY_BUFFER, p); gl.enableVertexAttribArray(at); gl.vertexAttribPointer(at, 3, gl.FLOAT, false, 0, 0);
    return key => gl.getUniformLocation(program, key);
  }
  points(m, { p, e, n }, size, colour) {
    const gl = this.gl, uniform = this.use("points", m, p), at = gl.getAttribLocation(this.programs.points, "e");
    if (e) { gl.bindBuffer(gl.ARRAY_BUFFER, e); gl.enableVertexAttribArray(at); gl.vertexAttribPointer(at, 1, gl.UNSIGNED_BYTE, false, 0, 0); }
    gl.uniform1f(uniform("size"), size); gl.uniform1f(uniform("px"), this.canvas.height); gl.uniform3fv(uniform("ramp"), (colour ? Array(5).fill(colour) : RAMP).flatMap(rgb));
    gl.drawArrays(gl.POINTS, 0, n); if (e) gl.disableVertexAttribArray(at);
  }
  lines(m, p, first, n, colour, mode = this.gl.LINES) { if (n > 0) { this.gl.uniform3fv(this.use("lines", m, p)("col"), rgb(colour)); this.gl.drawArrays(mode, first, n); } }
  draw() {
    const gl = this.gl, mission = this.mission, now = stepOf(mission), ratio = window.devicePixelRatio || 1;
    const width = Math.max(1, Math.round(this.canvas.clientWidth * ratio)), height = Math.max(1, Math.round(this.canvas.clientHeight * ratio));
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    gl.viewport(0, 0, width, height); gl.clearColor(0.125, 0.145, 0.17, 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const m = matrix(width / height), last = step >= mission.steps.length - 1, dense = last && this.dense && shown.dense;
    this.lines(m, this.grid, 0, 36, "#3d454f"); this.lines(m, this.grid, 36, 2, RED); this.lines(m, this.grid, 38, 2, "#4dbf66");
    if (shown.rock) {
      const uniform = this.use("rock", m, this.rock.p);
      gl.uniform3fv(uniform("eye"), eye()); gl.enable(gl.POLYGON_OFFSET_FILL); gl.polygonOffset(2, 2);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.rock.f); gl.drawElements(gl.TRIANGLES, this.rock.faces, gl.UNSIGNED_INT, 0); gl.disable(gl.POLYGON_OFFSET_FILL);
    }
    if (shown.missing && last) this.points(m, this.missing, 0.016, BROWN);
    if (dense) this.points(m, this.dense, 0.009); else if (shown.sparse && this.models[now.model]) this.points(m, this.models[now.model], 0.016);
    if (shown.path) {
      const all = this.samples.length / 4; let flown = 0; while (flown < all && this.samples[4 * flown] <= now.t + 1e-6) flown++;
      this.lines(m, this.path, 0, flown, "#dbe0e6", gl.LINE_STRIP); this.lines(m, this.path, Math.max(0, flown - 1), all - flown + 1, "#525c66", gl.LINE_STRIP);
    }
    if (shown.cameras) mission.views.slice(0, now.views).forEach((view, i) => this.lines(m, this.frusta, 16 * i, 16, view.lost ? RED : i === picked(mission) ? WHITE : i < mission.seeds ? BLUE : ORANGE));
    if (shown.photographs) mission.views.slice(0, now.views).forEach((view, i) => { if (view.image) { this.use("photograph", m, this.quads); gl.bindTexture(gl.TEXTURE_2D, this.photographs[i]); gl.drawArrays(gl.TRIANGLE_STRIP, 4 * i, 4); } });
    if (shown.pool && now.pool && mission.views[now.views]) {
      const temporary = places => ({ p: this.buffer(new Float32Array(places.flat())), n: places.length });
      const pool = temporary(now.pool), chosen = temporary([mission.views[now.views].at]), leg = temporary([mission.views[now.views - 1].at, mission.views[now.views].at]);
      this.points(m, pool, 0.06, GREY); this.points(m, chosen, 0.2, WHITE); this.lines(m, leg.p, 0, 2, WHITE);
      for (const { p } of [pool, chosen, leg]) gl.deleteBuffer(p);
    }
  }
}

const stepOf = mission => mission.steps[Math.min(step, mission.steps.length - 1)];
const picked = mission => mission.picked != null && mission.picked < stepOf(mission).views ? mission.picked : stepOf(mission).views - 1;

function tell({ mission, side, keys }) {
  const now = stepOf(mission), view = mission.views[picked(mission)], last = step >= mission.steps.length - 1;
  const facts = [["camera", view.name + (view.lost ? ", not registered" : "")], ...now.facts];
  side.innerHTML = `<h2>${safe(now.label)}</h2>` + (view.image ? `<img alt="photograph ${safe(view.name)}" src="data:image/jpeg;base64,${view.image}">` : "") +
    `<dl>${facts.map(([k, v]) => `<dt>${safe(k)}</dt><dd>${safe(v)}</dd>`).join("")}</dl>`;
  keys.innerHTML = `cloud: distance to rock or ground 0<i style="background:linear-gradient(90deg,${RAMP.join(",")})"></i>16 mm` + (last ? `<br>brown: observable surface with no point of the ${mission.against} cloud within 48 mm` : "");
}

$("more").open = innerWidth > 900;
const host = $("missions"); host.style.setProperty("--count", missions.length); document.body.className = missions.length > 1 ? "two" : "one";
const rooms = missions.map(mission => {
  const room = el("section", "", "mission"), space = el("div", "", "space"), canvas = el("canvas"), side = el("div", "", "side"), keys = el("div", "", "keys");
  canvas.setAttribute("aria-label", `mission ${mission.name} in space`);
  space.append(canvas, el("div", `${safe(mission.name)}<small>${safe(mission.what)}</small><b>${safe(mission.headline)}</b>`, "name"), keys);
  room.append(space, side); host.append(room); return { mission, canvas, side, keys };
});
for (const room of rooms) try { room.space = new Space(room.mission, room.canvas); } catch (error) { room.canvas.replaceWith(el("p", safe(error.message) + "; the figures beside still work.")); }
// The rock fills the view at first: the camera stands where its bounding sphere fits.
{
  const p = metres(missions[0].mesh.p, missions[0].origin), ends = [0, 1, 2].map(k => { const v = p.filter((_, i) => i % 3 === k); return [v.reduce((a, b) => Math.min(a, b)), v.reduce((a, b) => Math.max(a, b))]; });
  camera.at = ends.map(([low, high]) => (low + high) / 2); camera.far = 1.1 * Math.hypot(...ends.map(([low, high]) => high - low)) / 2 / Math.sin(HALF_FIELD_RAD);
}
// The camera that stands nearest to a click, among those taken by now; none far from it.
function nearest({ canvas, mission }, x, y) {
  const m = matrix(canvas.width / canvas.height), gaps = mission.views.slice(0, stepOf(mission).views).map(({ at }) => {
    const [u, v, , w] = [0, 1, 2, 3].map(r => m[r] * at[0] + m[4 + r] * at[1] + m[8 + r] * at[2] + m[12 + r]);
    return w > 0 ? Math.hypot((u / w + 1) / 2 * canvas.clientWidth - x, (1 - v / w) / 2 * canvas.clientHeight - y) : Infinity;
  });
  const least = Math.min(...gaps);
  return least < PICK_PX ? gaps.indexOf(least) : null;
}
let waiting = false;
function draw() { if (waiting) return; waiting = true; requestAnimationFrame(() => { waiting = false; for (const room of rooms) if (room.space) room.space.draw(); }); }
function update() {
  const longest = rooms.reduce((a, b) => a.mission.steps.length >= b.mission.steps.length ? a : b).mission;
  $("what").textContent = `${step + 1} of ${longest.steps.length}: ${longest.steps[step].label.replace(/: chose.*/, "")}`;
  rooms.forEach(tell); draw();
}

const slider = $("step"); slider.max = Math.max(...missions.map(m => m.steps.length)) - 1;
slider.oninput = () => { step = +slider.value; update(); };
const go = to => { step = Math.max(0, Math.min(+slider.max, to)); slider.value = step; update(); };
$("look").onclick = () => { const m = missions[0], d = sub(m.views[picked(m)].at, m.target); camera.at = [...m.target]; camera.far = Math.hypot(...d); camera.az = Math.atan2(d[1], d[0]); camera.el = Math.asin(d[2] / camera.far); draw(); };
for (const [name, label] of Object.entries(layers)) { const box = el("label", `<input type="checkbox" name="${name}" checked> ${label}`); box.firstChild.onchange = e => { shown[name] = e.target.checked; draw(); }; $("show").append(box); }

const fingers = new Map();
let pressed = null; // where, as long as nothing was dragged
const turn = (dx, dy) => { camera.az -= dx * 0.007; camera.el = Math.max(-1.5, Math.min(1.55, camera.el + dy * 0.007)); };
const move = (dx, dy, height) => { const [r, u] = axes(eye(), camera.at), s = camera.far / height; camera.at = add(add(camera.at, r, -dx * s), u, dy * s); };
const zoom = by => camera.far = Math.max(0.4, Math.min(60, camera.far * by));
for (const room of rooms) {
  const { canvas } = room;
  canvas.onpointerdown = e => { canvas.setPointerCapture(e.pointerId); pressed = fingers.size ? null : [e.offsetX, e.offsetY]; fingers.set(e.pointerId, [e.clientX, e.clientY]); };
  canvas.onpointercancel = e => fingers.delete(e.pointerId);
  canvas.onpointerup = e => { fingers.delete(e.pointerId); if (pressed && room.space) { room.mission.picked = nearest(room, ...pressed); update(); } pressed = null; };
  canvas.onpointermove = e => {
    const was = fingers.get(e.pointerId); if (!was) return;
    if (pressed && Math.hypot(e.offsetX - pressed[0], e.offsetY - pressed[1]) < 4) return;
    pressed = null;
    const dx = e.clientX - was[0], dy = e.clientY - was[1];
    if (fingers.size === 2) { const other = [...fingers].find(([id]) => id !== e.pointerId)[1], gap = p => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1; zoom(gap(was) / gap([e.clientX, e.clientY])); move(dx / 2, dy / 2, canvas.clientHeight); }
    else if (e.shiftKey || e.buttons === 2) move(dx, dy, canvas.clientHeight); else turn(dx, dy);
    fingers.set(e.pointerId, [e.clientX, e.clientY]); draw();
  };
  canvas.oncontextmenu = e => e.preventDefault();
  canvas.addEventListener("wheel", e => { e.preventDefault(); zoom(Math.exp(e.deltaY * 0.001)); draw(); }, { passive: false });
}
addEventListener("keydown", e => { if (["INPUT", "SELECT"].includes(e.target.tagName)) return; if (e.key === "ArrowRight") go(step + 1); if (e.key === "ArrowLeft") go(step - 1); });
addEventListener("resize", draw);
const wanted = location.hash.match(/step=(\d+)/); // page.html#step=27 opens there
go(wanted ? +wanted[1] - 1 : +slider.max);
