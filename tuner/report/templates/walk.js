"use strict";
// A mission in WebGL 2: four programs (points, lines, the rock, photographs), one camera that all missions share.
const STEP_M = 0.00025, RAMP = ["#2f7fd0", "#7cc4f2", "#f4f1e4", "#f2b233", "#e0531a"], VIRIDIS = ["#0d1a6b", "#3b4f9a", "#7c7b78", "#bcae6c", "#ffea46"];
const TERMS = [["main", "#0072B2"], ["nov", "#009E73"], ["move", "#D55E00"], ["ang", "#CC79A7"]];
const missions = JSON.parse(document.getElementById("data").textContent);
const HALF_FIELD_RAD = 0.45; // half the vertical field of view
const camera = { az: -1.0, el: 0.45, far: 6.8, at: [...missions[0].target] };
const $ = id => document.getElementById(id);
const el = (tag, html = "", cls = "") => Object.assign(document.createElement(tag), { innerHTML: html, className: cls });
const safe = text => String(text).replace(/[&<>"]/g, c => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[c]);
const rgb = hex => [1, 3, 5].map(i => parseInt(hex.slice(i, i + 2), 16) / 255);
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
const unpack = (text, Kind) => new Kind(bytes(text).buffer);

// Which layers there are, and what is shown at first.
const layers = [
  ["rock", "true rock", true], ["truth", "ground truth, by distance to the cloud", false], ["holes", "only holes (over 48 mm)", true],
  ["observable", "only the observable surface", false], ["sparse", "sparse cloud", true], ["dense", "dense cloud (at the end)", true],
  ["frusta", "cameras", true], ["photos", "photographs", true], ["pool", "candidate pool", true], ["path", "path", true]];
const shown = Object.fromEntries(layers.map(([key, , on]) => [key, on]));
let colouring = "error", scorer = "flown", step = 0;
const PICK_PX = 24; // a click nearer to a camera than this picks it

// Matrices are columns first, as WebGL wants them.
const sub = (a, b) => a.map((v, i) => v - b[i]), dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const add = (a, b, s = 1) => a.map((v, i) => v + s * b[i]);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = a => { const n = Math.hypot(...a) || 1; return a.map(v => v / n); };
const product = (a, b) => { const c = new Float32Array(16); for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++) for (let k = 0; k < 4; k++) c[4 * j + i] += a[4 * k + i] * b[4 * j + k]; return c; };
const eye = () => { const c = Math.cos(camera.el); return add(camera.at, [c * Math.cos(camera.az), c * Math.sin(camera.az), Math.sin(camera.el)], camera.far); };
function axes(from, to) {
  const forward = unit(sub(to, from));
  let right = cross(forward, [0, 0, 1]);
  right = unit(Math.hypot(...right) < 1e-6 ? [1, 0, 0] : right);
  return [right, cross(right, forward), forward];
}
function matrix(aspect) {
  const [r, u, f] = axes(eye(), camera.at), e = eye(), near = 0.03, far = 200, s = 1 / Math.tan(HALF_FIELD_RAD);
  const view = [r[0], u[0], -f[0], 0, r[1], u[1], -f[1], 0, r[2], u[2], -f[2], 0, -dot(r, e), -dot(u, e), dot(f, e), 1];
  return product([s / Math.max(aspect, 1) * Math.min(1, aspect) / (aspect < 1 ? aspect : 1), 0, 0, 0, 0, s * (aspect < 1 ? aspect : 1), 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, 2 * far * near / (near - far), 0], view);
}

const HEAD = "#version 300 es\nprecision highp float;\n";
const SHADERS = {
  points: [`in vec3 p; in vec3 c; in float a; in float b; uniform mat4 m; uniform vec3 o; uniform float q, size, px, span, low, only, over; uniform int how; uniform vec3 ramp[5]; out vec3 col;
    void main() { gl_Position = m * vec4(o + q * p, 1.0); gl_PointSize = clamp(size * px / gl_Position.w, 1.5, 40.0);
      if ((only > 0.5 && b < 0.5) || (over > 0.0 && a < over)) gl_Position = vec4(2, 2, 2, 1);
      float t = clamp((a - low) / span, 0.0, 1.0) * 4.0; int i = min(int(t), 3);
      col = how == 0 ? c / 255.0 : mix(ramp[i], ramp[i + 1], t - float(i)); }`,
    `in vec3 col; out vec4 o; uniform float round_; void main() { vec2 d = gl_PointCoord - 0.5; if (round_ > 0.5 && dot(d, d) > 0.25) discard; o = vec4(col, 1); }`],
  lines: [`in vec3 p; uniform mat4 m; void main() { gl_Position = m * vec4(p, 1.0); }`, `uniform vec4 col; out vec4 o; void main() { o = col; }`],
  rock: [`in vec3 p; uniform mat4 m; uniform vec3 o; uniform float q; out vec3 w; void main() { w = o + q * p; gl_Position = m * vec4(w, 1.0); }`,
    `in vec3 w; out vec4 o; uniform vec3 e; void main() { vec3 n = normalize(cross(dFdx(w), dFdy(w))); float s = abs(dot(n, normalize(e - w))); o = vec4(vec3(0.42, 0.43, 0.45) * (0.35 + 0.65 * s), 1); }`],
  photos: [`in vec3 p; in vec2 c; uniform mat4 m; out vec2 t; void main() { t = c; gl_Position = m * vec4(p, 1.0); }`, `in vec2 t; out vec4 o; uniform sampler2D s; void main() { o = texture(s, t); }`],
};

class Space {
  constructor(mission, canvas) {
    this.mission = mission; this.canvas = canvas;
    const gl = this.gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    if (!gl) throw new Error("WebGL 2 is switched off in this browser");
    this.programs = Object.fromEntries(Object.entries(SHADERS).map(([name, [v, f]]) => [name, this.program(HEAD + v, HEAD + f)]));
    gl.enable(gl.DEPTH_TEST); gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    const cloud = c => c && ({ n: bytes(c.p).length / 6, p: this.buffer(unpack(c.p, Int16Array)), e: c.e && this.buffer(bytes(c.e)), k: c.n && this.buffer(bytes(c.n)), c: c.c && this.buffer(bytes(c.c)) });
    this.models = mission.models.map(cloud); this.dense = cloud(mission.dense);
    this.truth = { ...cloud({ p: mission.truth.p }), m: this.buffer(bytes(mission.truth.m)), o: this.buffer(bytes(mission.truth.o)) };
    const faces = unpack(mission.mesh.f, Uint32Array);
    this.rock = { p: this.buffer(unpack(mission.mesh.p, Int16Array)), f: this.buffer(faces, gl.ELEMENT_ARRAY_BUFFER), n: faces.length };
    this.samples = unpack(mission.path, Float32Array);
    const path = []; for (let i = 0; i < this.samples.length; i += 4) path.push(...this.samples.slice(i + 1, i + 4));
    this.path = { p: this.buffer(new Float32Array(path)), n: path.length / 3 };
    const [x, y] = mission.target, grid = []; for (let i = -4; i <= 4; i++) grid.push(x + i, y - 4, 0, x + i, y + 4, 0, x - 4, y + i, 0, x + 4, y + i, 0);
    this.grid = { p: this.buffer(new Float32Array(grid)), n: grid.length / 3 };
    this.axes = [[1, 0, 0], [0, 1, 0]].map(d => this.buffer(new Float32Array([x - 4, y - 4, 0, x - 4 + d[0], y - 4 + d[1], 0])));
    this.frusta = this.cameras(); this.dynamic = gl.createBuffer(); this.photographs();
  }
  program(v, f) {
    const gl = this.gl, p = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, v], [gl.FRAGMENT_SHADER, f]]) { const s = gl.createShader(kind); gl.shaderSource(s, text); gl.compileShader(s); gl.attachShader(p, s); if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(s)); }
    gl.linkProgram(p); return p;
  }
  buffer(values, kind = this.gl.ARRAY_BUFFER) { const b = this.gl.createBuffer(); this.gl.bindBuffer(kind, b); this.gl.bufferData(kind, values, this.gl.STATIC_DRAW); return b; }
  cameras() {
    const [w, h, f] = this.mission.camera, depth = 0.24, edges = [], quads = [];
    for (const { at } of this.mission.views) {
      const [r, u, fw] = axes(at, this.mission.target), mid = add(at, fw, depth);
      const corner = (sx, sy) => add(add(mid, r, sx * depth * w / 2 / f), u, sy * depth * h / 2 / f);
      const c = [corner(-1, 1), corner(1, 1), corner(1, -1), corner(-1, -1)];
      for (let i = 0; i < 4; i++) edges.push(...at, ...c[i], ...c[i], ...c[(i + 1) % 4]);
      quads.push(c);
    }
    this.quads = quads; return { p: this.buffer(new Float32Array(edges)), each: 16 };
  }
  photographs() {
    const gl = this.gl, views = this.mission.views, columns = Math.ceil(Math.sqrt(views.length)), [w, h] = this.mission.camera;
    const tw = Math.min(320, Math.floor(4096 / columns)), th = Math.round(tw * h / w), atlas = Object.assign(document.createElement("canvas"), { width: tw * columns, height: th * Math.ceil(views.length / columns) });
    const context = atlas.getContext("2d"), data = []; this.pictures = [];
    Promise.all(views.map((view, i) => new Promise(done => {
      if (!view.image) return done();
      const image = new Image(), x = i % columns, y = Math.floor(i / columns);
      image.onload = () => {
        context.drawImage(image, x * tw, y * th, tw, th);
        const [a, b, c, d] = this.quads[i], u0 = x * tw / atlas.width, v0 = y * th / atlas.height, u1 = (x + 1) * tw / atlas.width, v1 = (y + 1) * th / atlas.height;
        data[i] = [...a, u0, v0, ...b, u1, v0, ...c, u1, v1, ...a, u0, v0, ...c, u1, v1, ...d, u0, v1]; done();
      };
      image.onerror = done; image.src = "data:image/jpeg;base64," + view.image;
    }))).then(() => {
      const all = views.flatMap((_, i) => data[i] || Array(30).fill(0));
      this.photos = { p: this.buffer(new Float32Array(all)), t: gl.createTexture() };
      gl.bindTexture(gl.TEXTURE_2D, this.photos.t); gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, atlas); gl.generateMipmap(gl.TEXTURE_2D); draw();
    });
  }
  use(name, m) { const gl = this.gl, p = this.programs[name]; gl.useProgram(p); gl.uniformMatrix4fv(gl.getUniformLocation(p, "m"), false, m); for (let i = 0; i < 4; i++) gl.disableVertexAttribArray(i); return key => gl.getUniformLocation(p, key); }
  attribute(program, name, buffer, size, type, stride = 0, offset = 0) {
    const gl = this.gl, at = gl.getAttribLocation(this.programs[program], name); if (at < 0) return;
    if (!buffer) { gl.disableVertexAttribArray(at); gl.vertexAttrib3f(at, 0, 0, 0); return; }
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer); gl.enableVertexAttribArray(at); gl.vertexAttribPointer(at, size, type, false, stride, offset);
  }
  points(m, n, { p, c, a, b, float = false, size, span = 1, low = 0, ramp = RAMP, only = false, over = 0 }) {
    const gl = this.gl, at = this.use("points", m);
    this.attribute("points", "p", p, 3, float ? gl.FLOAT : gl.SHORT); this.attribute("points", "c", c, 3, gl.UNSIGNED_BYTE);
    this.attribute("points", "a", a, 1, float ? gl.FLOAT : gl.UNSIGNED_BYTE); this.attribute("points", "b", b, 1, gl.UNSIGNED_BYTE);
    gl.uniform3fv(at("o"), float ? [0, 0, 0] : this.mission.origin);
    for (const [key, value] of Object.entries({ q: float ? 1 : STEP_M, size, px: this.canvas.height, span, low, only: +only, over, round_: +float })) gl.uniform1f(at(key), value);
    gl.uniform1i(at("how"), c ? 0 : 1); gl.uniform3fv(at("ramp"), ramp.flatMap(rgb)); gl.drawArrays(gl.POINTS, 0, n);
  }
  lines(m, buffer, first, n, colour, mode = this.gl.LINES) { if (n <= 0) return; const at = this.use("lines", m); this.attribute("lines", "p", buffer, 3, this.gl.FLOAT); this.gl.uniform4fv(at("col"), colour); this.gl.drawArrays(mode, first, n); }
  draw() {
    const gl = this.gl, mission = this.mission, now = mission.steps[Math.min(step, mission.steps.length - 1)], ratio = window.devicePixelRatio || 1;
    const width = Math.max(1, Math.round(this.canvas.clientWidth * ratio)), height = Math.max(1, Math.round(this.canvas.clientHeight * ratio));
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    gl.viewport(0, 0, width, height); gl.clearColor(0.125, 0.145, 0.17, 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const m = matrix(width / height), last = step >= mission.steps.length - 1, dense = last && this.dense && shown.dense;
    this.lines(m, this.grid.p, 0, this.grid.n, [0.24, 0.27, 0.31, 1]);
    this.axes.forEach((axis, i) => this.lines(m, axis, 0, 2, i ? [0.3, 0.75, 0.4, 1] : [0.9, 0.35, 0.3, 1]));
    if (shown.rock) {
      const at = this.use("rock", m); this.attribute("rock", "p", this.rock.p, 3, gl.SHORT); gl.uniform3fv(at("o"), mission.origin); gl.uniform1f(at("q"), STEP_M); gl.uniform3fv(at("e"), eye());
      gl.enable(gl.POLYGON_OFFSET_FILL); gl.polygonOffset(2, 2); gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.rock.f); gl.drawElements(gl.TRIANGLES, this.rock.n, gl.UNSIGNED_INT, 0); gl.disable(gl.POLYGON_OFFSET_FILL);
    }
    if (shown.truth || shown.holes) this.points(m, this.truth.n, { p: this.truth.p, a: this.truth.m, b: this.truth.o, size: 0.013, span: 80, only: shown.observable, over: shown.holes ? 48 : 0 });
    const model = this.models[now.model];
    if (model && shown.sparse && !dense) this.points(m, model.n, { p: model.p, size: 0.016, ...(colouring === "tracks" ? { a: model.k, low: 2, span: 8, ramp: VIRIDIS } : { a: model.e, span: 64 }) });
    if (dense) this.points(m, this.dense.n, { p: this.dense.p, size: 0.009, ...(colouring === "photo" && this.dense.c ? { c: this.dense.c } : { a: this.dense.e, span: 64 }) });
    if (shown.path) {
      let flown = 0; while (flown < this.path.n && this.samples[4 * flown] <= now.t + 1e-6) flown++;
      this.lines(m, this.path.p, 0, flown, [0.86, 0.88, 0.9, 1], gl.LINE_STRIP); this.lines(m, this.path.p, Math.max(0, flown - 1), this.path.n - flown + 1, [0.32, 0.36, 0.4, 1], gl.LINE_STRIP);
    }
    if (shown.frusta) for (let i = 0; i < now.views; i++) this.lines(m, this.frusta.p, i * 16, 16, mission.views[i].lost ? [0.9, 0.25, 0.2, 1] : i === mission.picked || (i === now.views - 1 && !last && mission.picked == null) ? [1, 1, 1, 1] : i < mission.seeds ? [0.34, 0.7, 0.91, 1] : [0.9, 0.62, 0, 1]);
    if (shown.photos && this.photos) { this.use("photos", m); gl.bindTexture(gl.TEXTURE_2D, this.photos.t); this.attribute("photos", "p", this.photos.p, 3, gl.FLOAT, 20, 0); this.attribute("photos", "c", this.photos.p, 2, gl.FLOAT, 20, 12); gl.drawArrays(gl.TRIANGLES, 0, 6 * now.views); }
    if (shown.pool && now.pool) {
      const scores = now.pool.scores[chosenScorer(now)], upload = (values) => { const b = gl.createBuffer(); gl.bindBuffer(gl.ARRAY_BUFFER, b); gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(values), gl.STREAM_DRAW); return b; };
      const places = upload(now.pool.at.flat()), values = upload(scores || now.pool.ids.map(() => 0)), lowest = scores ? Math.min(...scores) : 0, best = now.pool.ids.indexOf(now.chosen);
      this.points(m, now.pool.ids.length, { p: places, a: values, float: true, size: 0.09, low: lowest, span: scores ? Math.max(...scores) - lowest || 1 : 1, ramp: VIRIDIS });
      const mark = upload(now.pool.at[best]), big = upload([1]); this.points(m, 1, { p: mark, a: big, float: true, size: 0.2, ramp: Array(5).fill("#ffffff") });
      const leg = upload([...mission.views[now.views - 1].at, ...now.pool.at[best]]); this.lines(m, leg, 0, 2, [1, 1, 1, 1]);
      for (const b of [places, values, mark, big, leg]) gl.deleteBuffer(b);
    }
  }
}

const chosenScorer = now => scorer !== "flown" && now.pool.scores[scorer] ? scorer : now.pool.scores[now.scorer] ? now.scorer : Object.keys(now.pool.scores)[0];
const gradient = ramp => `background:linear-gradient(90deg,${ramp.join(",")})`;

function bars(now) {
  const name = chosenScorer(now), best = name && now.pool.best[name];
  if (!best) return "<p>No scorer ranked this pool.</p>";
  const low = Math.min(0, ...best.map(b => b.terms.filter(t => t < 0).reduce((a, t) => a + t, 0))), high = Math.max(...best.map(b => b.terms.filter(t => t > 0).reduce((a, t) => a + t, 0)));
  const x = v => 72 + (v - low) / (high - low || 1) * 218, rows = best.map((b, i) => {
    let up = 0, down = 0, text = `<text x="0" y="${i * 19 + 13}" ${b.id === now.chosen ? 'font-weight="700"' : ""}>${safe(b.id)}</text>`;
    b.terms.forEach((t, k) => { const from = t >= 0 ? up : down + t, w = x(from + Math.abs(t)) - x(from); if (t >= 0) up += t; else down += t; text += `<rect x="${x(from).toFixed(1)}" y="${i * 19 + 3}" width="${w.toFixed(1)}" height="13" fill="${TERMS[k][1]}"><title>${TERMS[k][0]} ${t}</title></rect>`; });
    return text + `<text class="soft" x="296" y="${i * 19 + 13}">${b.score.toFixed(3)}</text>`;
  });
  return `<svg viewBox="0 0 340 ${best.length * 19 + 4}" role="img" aria-label="terms of Eq. 1">${rows.join("")}<line x1="${x(0)}" x2="${x(0)}" y1="0" y2="${best.length * 19}" stroke="#a9b4bf"/></svg><div class="legend">${TERMS.map(([t, c]) => `<span><b style="background:${c}"></b>${t}</span>`).join("")}</div>`;
}
function curve(mission, key, title, unit) {
  const values = mission.steps.map((s, i) => [i, s[key]]).filter(([, v]) => v != null); if (values.length < 2) return "";
  const all = values.map(v => v[1]), least = Math.min(...all), most = Math.max(...all), first = values[0][0], count = Math.max(1, mission.steps.length - 1 - first), x = i => 6 + 250 * (i - first) / count, y = v => 50 - 40 * (v - least) / (most - least || 1);
  const here = values.filter(([i]) => i <= step).pop();
  return `<h2>${title}</h2><svg viewBox="0 0 340 60" role="img" aria-label="${title}"><polyline fill="none" stroke="#56B4E9" stroke-width="1.6" points="${values.map(([i, v]) => `${x(i).toFixed(1)},${y(v).toFixed(1)}`).join(" ")}"/><line x1="6" x2="256" y1="52" y2="52" stroke="#3c454f"/>${here ? `<circle cx="${x(here[0])}" cy="${y(here[1])}" r="4" fill="#E69F00"/><text x="264" y="30">${here[1].toFixed(1)} ${unit}</text>` : ""}<text class="soft" x="264" y="48">${least.toFixed(0)} to ${most.toFixed(0)}</text></svg>`;
}
function tell(mission, side) {
  const now = mission.steps[Math.min(step, mission.steps.length - 1)], last = now.views - 1, picked = mission.picked != null && mission.picked <= last, view = mission.views[picked ? mission.picked : last], facts = [];
  if (now.scorer) facts.push(["scorer", now.scorer], ["why", now.reason], ["candidates", now.pool.ids.length]);
  if (now.registered != null) facts.push(["registered", `${now.registered} of ${now.views} photographs`]);
  if (now.points != null) facts.push(["sparse points", now.points]);
  if (step >= mission.steps.length - 1) facts.push(["status", mission.status + (mission.message ? ": " + mission.message : "")], ...mission.scores);
  side.innerHTML = `<h2>${safe(now.label)}</h2>` + (view.image ? `<img alt="photograph ${safe(view.name)}" src="data:image/jpeg;base64,${view.image}">` : "") + `<dl><dt>${picked ? "camera picked" : "last view"}</dt><dd>${safe(view.name)}${view.lost ? ", not registered" : ""}</dd>` + facts.map(([k, v]) => `<dt>${safe(k)}</dt><dd>${safe(v)}</dd>`).join("") + "</dl>" +
    (now.pool ? `<h2>Terms of Eq. 1, best candidates of ${safe(chosenScorer(now) || "")}</h2>${bars(now)}` : "") +
    curve(mission, "d95_mm", "d95 of the sparse cloud", "mm") + curve(mission, "sparse_completeness", "Observable surface within 48 mm of the sparse cloud", "%");
}
function key(mission, box) {
  const last = step >= mission.steps.length - 1, parts = [];
  if (colouring === "error" || (colouring === "tracks" && last && mission.dense && shown.dense)) parts.push(`clouds: distance to rock or ground 0<i style="${gradient(RAMP)}"></i>16 mm`);
  else if (colouring === "tracks") parts.push(`sparse: photographs per point 2<i style="${gradient(VIRIDIS)}"></i>10`);
  if (shown.truth || shown.holes) parts.push(`truth: distance to the final ${mission.truthAgainst} 0<i style="${gradient(RAMP)}"></i>80 mm`);
  if (shown.pool && !last && mission.steps[step].pool) parts.push(`pool: score, low<i style="${gradient(VIRIDIS)}"></i>high; white: chosen`);
  box.innerHTML = parts.join("<br>");
}

$("more").open = innerWidth > 900;
const host = $("missions"); host.style.setProperty("--count", missions.length); document.body.className = missions.length > 1 ? "two" : "one";
const rooms = missions.map(mission => {
  mission.seeds = mission.steps.filter(s => s.label.startsWith("seed")).length;
  const room = el("section", "", "mission"), space = el("div", "", "space"), canvas = el("canvas"), side = el("div", "", "side"), keys = el("div", "", "keys");
  canvas.setAttribute("aria-label", `mission ${mission.name} in space`);
  space.append(canvas, el("div", `${safe(mission.name)}<small>${safe([mission.rock, "replicate " + mission.replicate, mission.condition, mission.gate, mission.fidelity].join(" · "))}</small><b>${safe(mission.headline)}</b>`, "name"), keys);
  room.append(space, side); host.append(room); return { mission, canvas, side, keys };
});
for (const room of rooms) try { room.space = new Space(room.mission, room.canvas); } catch (error) { room.canvas.replaceWith(el("p", safe(error.message) + "; the figures beside still work.")); }
// The rock fills the view at first: the camera stands where its bounding sphere fits.
function fit() {
  const [first] = missions, p = unpack(first.mesh.p, Int16Array), low = [Infinity, Infinity, Infinity], high = low.map(v => -v);
  for (let i = 0; i < p.length; i++) { const v = first.origin[i % 3] + STEP_M * p[i]; low[i % 3] = Math.min(low[i % 3], v); high[i % 3] = Math.max(high[i % 3], v); }
  if (!p.length) return;
  camera.at = low.map((v, i) => (v + high[i]) / 2); camera.far = 1.1 * Math.hypot(...sub(high, low)) / 2 / Math.sin(HALF_FIELD_RAD);
}
// The camera whose picture stands nearest to a click, among those taken by now; none far from it.
function nearest(room, x, y) {
  const { canvas, mission, space } = room, m = matrix(canvas.width / canvas.height), now = mission.steps[Math.min(step, mission.steps.length - 1)];
  let best = null, least = PICK_PX;
  for (let i = 0; i < now.views; i++) {
    const [a, b, c, d] = space.quads[i], mid = [0, 1, 2].map(k => (a[k] + b[k] + c[k] + d[k]) / 4);
    for (const at of [mission.views[i].at, mid]) {
      const [u, v, , w] = [0, 1, 2, 3].map(r => m[r] * at[0] + m[4 + r] * at[1] + m[8 + r] * at[2] + m[12 + r]);
      const gap = w > 0 ? Math.hypot((u / w + 1) / 2 * canvas.clientWidth - x, (1 - v / w) / 2 * canvas.clientHeight - y) : Infinity;
      if (gap < least) { least = gap; best = i; }
    }
  }
  return best;
}
let waiting = false;
function draw() { if (waiting) return; waiting = true; requestAnimationFrame(() => { waiting = false; for (const room of rooms) if (room.space) room.space.draw(); }); }
function update() {
  const longest = rooms.reduce((a, b) => a.mission.steps.length >= b.mission.steps.length ? a : b).mission;
  $("what").textContent = `${step + 1} of ${longest.steps.length}: ${longest.steps[step].label.replace(/: chose.*/, "")}`;
  for (const room of rooms) { tell(room.mission, room.side); key(room.mission, room.keys); } draw();
}

const slider = $("step"); slider.max = Math.max(...missions.map(m => m.steps.length)) - 1;
slider.oninput = () => { step = +slider.value; update(); };
const go = to => { step = Math.max(0, Math.min(+slider.max, to)); slider.value = step; update(); };
let timer = 0;
$("play").onclick = () => { if (timer) { clearInterval(timer); timer = 0; } else { if (step >= +slider.max) go(0); timer = setInterval(() => { go(step + 1); if (step >= +slider.max) $("play").click(); }, 700); } $("play").textContent = timer ? "pause" : "play"; };
$("look").onclick = () => { const m = missions[0], view = m.views[m.steps[Math.min(step, m.steps.length - 1)].views - 1], d = sub(view.at, m.target); camera.at = [...m.target]; camera.far = Math.hypot(...d); camera.az = Math.atan2(d[1], d[0]); camera.el = Math.asin(d[2] / camera.far); draw(); };
for (const [name, label, on] of layers) { const box = el("label", `<input type="checkbox" ${on ? "checked" : ""}> ${label}`); box.firstChild.onchange = e => { shown[name] = e.target.checked; update(); }; box.firstChild.name = name; $("show").append(box); }
const choice = (label, options, change) => { const box = el("label", label + " "), select = el("select"); for (const [value, text] of options) select.append(Object.assign(el("option", text), { value })); select.onchange = () => { change(select.value); update(); }; box.append(select); $("show").append(box); };
choice("clouds by", [["error", "error"], ["tracks", "track length"], ["photo", "photograph"]], v => colouring = v);
choice("scores of", [["flown", "the scorer flown"], ...[...new Set(missions.flatMap(m => m.steps.flatMap(s => s.pool ? Object.keys(s.pool.scores) : [])))].map(n => [n, n])], v => scorer = v);

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
fit();
go(wanted ? +wanted[1] - 1 : +slider.max);
