"use strict";
(() => {
  const data = JSON.parse(document.getElementById("explorer-data").textContent);
  const SVG = "http://www.w3.org/2000/svg";
  const BLUE = "#0072B2", INK = "#1d2329", SOFT = "#59636e", LINE = "#d9dee3", RED = "#D55E00";
  const filter = document.getElementById("rock-filter"), tip = document.getElementById("tip");
  const decimal = (v, digits) => (digits < 0 || (digits > 6 && Math.abs(v) < 1e-3) ? (v ? v.toExponential(2) : "0") : v.toFixed(digits));
  const text = (v, digits = data.digits) => (v === null || v === undefined ? "–" : decimal(v, digits).replaceAll("-", "−"));
  const tickDigits = (low, high) => Math.min(data.digits, Math.max(0, -Math.floor(Math.log10((high - low) / 4))));

  const el = (name, attributes, parent, content) => {
    const node = document.createElementNS(SVG, name);
    for (const key in attributes) node.setAttribute(key, attributes[key]);
    if (content !== undefined) node.textContent = content;
    if (parent) parent.appendChild(node);
    return node;
  };
  const shownTrials = () => data.trials.filter((t) => !filter.value || t.where === filter.value);
  const roomFor = (low, high, digits) => 6 + 6.6 * Math.max(text(low, digits).length, text(high, digits).length); // labels of an axis
  const range = (values) => {
    let low = Math.min(...values), high = Math.max(...values);
    if (!(high > low)) { low -= 1; high += 1; }
    const room = 0.06 * (high - low);
    return [low - room, high + room];
  };
  const canvas = (id, height, least = 330) => {
    const box = document.getElementById(id), room = Math.min(1032, box.clientWidth || 1032), width = Math.max(least, room);
    box.textContent = "";
    return [el("svg", { viewBox: `0 0 ${width} ${height}`, style: width > room ? `width: ${width}px` : "width: 100%", class: "drawing", role: "img",
      "aria-label": box.dataset.label }, box), width];
  };
  const about = (t) => `mission ${String(t.n).padStart(4, "0")}, ${t.where}, replicate ${t.rep}: ${t.raw === null ? t.state : text(t.raw)}` +
    (t.raw !== null && t.state !== "ok" ? ` (${t.state})` : "") + ` · ${t.why}` +
    data.parameters.map((p, i) => `\n${p.short} ${t.v[i]} ${p.unit}`).join("");
  const say = (node, words) => {
    node.addEventListener("mousemove", (e) => {
      tip.textContent = words; tip.hidden = false;
      tip.style.left = `${Math.min(e.pageX + 12, scrollX + innerWidth - tip.offsetWidth - 8)}px`;
      tip.style.top = `${e.pageY + 14}px`;
    });
    node.addEventListener("mouseleave", () => { tip.hidden = true; });
  };
  const linked = (parent, t) => {
    const g = t.href ? el("a", { href: t.href.split("/").map(encodeURIComponent).join("/") }, parent) : el("g", {}, parent);
    say(g, about(t));
    return g;
  };

  const PALETTE = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#999999", "#882255", "#999933"];
  const places = [...new Set(data.trials.map((t) => t.where))];
  const colour = (t) => PALETTE[places.indexOf(t.where) % PALETTE.length];
  const betters = (a, b) => (data.sign > 0 ? a > b : a < b);

  // Outcomes over `key` of every trial; `lines`: with the best so far of every rock.
  function scatter(id, key, label, lines) {
    if (!document.getElementById(id)) return;
    const [svg, width] = canvas(id, 270), trials = shownTrials().filter((t) => t[key] !== null);
    const values = trials.filter((t) => t.raw !== null).map((t) => t.raw);
    if (!values.length) { el("text", { x: 8, y: 20 }, svg, "no successful mission here"); return; }
    let [low, high] = range(values);
    if (data.most !== null) high = Math.min(high, data.most);
    const digits = tickDigits(low, high), left = roomFor(low, high, digits);
    const xs = data.trials.filter((t) => t[key] !== null).map((t) => t[key]), first = Math.min(...xs), last = Math.max(...xs);
    const x = (n) => left + 10 + (width - left - 26) * (n - first) / Math.max(1, last - first), y = (v) => 205 - 190 * (v - low) / (high - low);
    for (let k = 0; k <= 4; k++) {
      const v = low + k * (high - low) / 4;
      el("line", { x1: left + 4, x2: width - 8, y1: y(v), y2: y(v), stroke: LINE }, svg);
      el("text", { x: left, y: y(v) + 4, "text-anchor": "end", class: "soft" }, svg, text(v, digits));
    }
    el("text", { x: left + 10, y: 243, class: "soft" }, svg, `${label} ${first} to ${last}; ${data.axis}`);
    let at = left + 10;
    for (const where of new Set(trials.map((t) => t.where))) {
      el("circle", { cx: at, cy: 258, r: 4, fill: colour({ where }) }, svg);
      el("text", { x: at + 8, y: 262, class: "soft" }, svg, where);
      at += 24 + 7 * where.length;
      if (!lines) continue;
      let best = null, path = "";
      for (const t of trials.filter((o) => o.where === where && o.raw !== null)) {
        if (best !== null) path += `H${x(t[key])}`;
        if (best === null || betters(t.raw, best)) { best = t.raw; path += `${path ? "V" : `M${x(t[key])} `}${y(best)}`; }
      }
      if (path) el("path", { d: `${path}H${x(last)}`, fill: "none", stroke: colour({ where }), "stroke-width": 1.2, opacity: 0.6 }, svg);
    }
    for (const t of trials) {
      const g = linked(svg, t), c = colour(t);
      if (t.raw === null) el("path", { d: `M${x(t[key]) - 4} 216l8 8m0 -8l-8 8`, stroke: RED, "stroke-width": 2, fill: "none" }, g);
      else if (t.best) el("circle", { cx: x(t[key]), cy: y(t.raw), r: 6, fill: c }, g);
      else if (t.default) el("circle", { cx: x(t[key]), cy: y(t.raw), r: 5, fill: "#fff", stroke: c, "stroke-width": 1.8 }, g);
      else el("circle", { cx: x(t[key]), cy: y(t.raw), r: 3.5, fill: c, opacity: 0.75 }, g);
    }
  }
  function history() {
    scatter("history", "n", "trial", true);
    scatter("photographs", "photos", "photographs", false);
  }

  function slices() {
    const box = document.getElementById("slices"), trials = shownTrials().filter((t) => t.adj !== null);
    box.textContent = "";
    if (!data.slices.length) return;
    const all = data.slices.flatMap((s) => s.mean.flatMap((m, i) => [m - 1.96 * s.sd[i], m + 1.96 * s.sd[i]]));
    let [low, high] = range([...all, ...trials.map((t) => t.adj)]);
    if (data.most !== null) high = Math.min(high, data.most);
    const digits = tickDigits(low, high), left = roomFor(low, high, digits);
    data.slices.forEach((s, k) => {
      const p = data.parameters[k];
      const svg = el("svg", { viewBox: "0 0 320 190", class: "drawing slice", role: "img", "aria-label": `slice along ${p.name}` }, box);
      const x = (u) => left + 4 + (304 - left) * u, y = (v) => 150 - 125 * (v - low) / (high - low);
      el("text", { x: left + 4, y: 14 }, svg, p.name + (p.unit ? ` (${p.unit})` : ""));
      for (const v of [low, (low + high) / 2, high]) {
        el("line", { x1: left + 4, x2: 308, y1: y(v), y2: y(v), stroke: LINE }, svg);
        el("text", { x: left, y: y(v) + 4, "text-anchor": "end", class: "soft" }, svg, text(v, digits));
      }
      const edge = (sign) => s.mean.map((m, i) => [x(s.u[i]), y(m + sign * 1.96 * s.sd[i])]);
      if (p.choices) {
        s.mean.forEach((m, i) => {
          el("line", { x1: x(s.u[i]), x2: x(s.u[i]), y1: edge(1)[i][1], y2: edge(-1)[i][1], stroke: BLUE, "stroke-width": 3, opacity: 0.4 }, svg);
          el("circle", { cx: x(s.u[i]), cy: y(m), r: 4, fill: BLUE }, svg);
        });
      } else {
        el("polygon", { points: [...edge(1), ...edge(-1).reverse()].join(" "), fill: BLUE, opacity: 0.16 }, svg);
        el("polyline", { points: s.mean.map((m, i) => `${x(s.u[i])},${y(m)}`).join(" "), fill: "none", stroke: BLUE, "stroke-width": 2 }, svg);
      }
      el("line", { x1: x(data.best[k]), x2: x(data.best[k]), y1: 22, y2: 152, stroke: INK, "stroke-dasharray": "4 3" }, svg);
      for (const [u, label] of p.ticks) {
        el("text", { x: x(u), y: 166, "text-anchor": u < 0.1 ? "start" : u > 0.9 ? "end" : "middle", class: "soft" }, svg, label);
      }
      const hit = el("rect", { x: left + 4, y: 20, width: 304 - left, height: 134, fill: "transparent" }, svg);
      for (const t of trials) {
        el("circle", { cx: x(t.u[k]), cy: y(t.adj), r: t.best ? 4.5 : 2.5, fill: t.best ? BLUE : SOFT, opacity: 0.7 }, linked(svg, t));
      }
      const reading = el("text", { x: left + 4, y: 184, class: "soft" }, svg, " ");
      hit.addEventListener("mousemove", (e) => {
        const at = svg.getBoundingClientRect(), u = ((e.clientX - at.left) / at.width * 320 - left - 4) / (304 - left);
        let i = 0;
        s.u.forEach((v, j) => { if (Math.abs(v - u) < Math.abs(s.u[i] - u)) i = j; });
        reading.textContent = `at ${s.v[i]}: ${text(s.mean[i])} (95 %: ${text(s.mean[i] - 1.96 * s.sd[i])} to ${text(s.mean[i] + 1.96 * s.sd[i])})`;
      });
    });
  }

  const draw = () => { history(); slices(); };
  for (const where of [...new Set(data.trials.map((t) => t.where))]) {
    const option = document.createElement("option");
    option.value = option.textContent = where;
    filter.appendChild(option);
  }
  filter.addEventListener("change", draw);
  addEventListener("resize", draw);
  draw();
})();
