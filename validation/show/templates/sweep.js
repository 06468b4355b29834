const data = JSON.parse(document.getElementById("map-data").textContent);
const root = document.getElementById("map-live");
const $ = (name) => root.querySelector(`[data-part="${name}"]`);
const canvas = $("canvas"), tip = $("tip"), legend = $("legend"), picked = $("picked"), note = $("note");
const choose = { x: $("x"), y: $("y"), colour: $("colour"), view: $("view") };
const N = data.points;

const state = bytes(data.state);
for (const axis of data.axes) {
  const raw = bytes(axis.values), view = new DataView(raw.buffer);
  axis.at = new Float64Array(N);
  for (let i = 0; i < N; i++) {
    const q = view.getUint16(2 * i, true);
    axis.at[i] = q === ABSENT ? NaN : q === INFINITE ? Infinity : axis.low + (axis.high - axis.low) * q / TOP;
    if (axis.levels && q < INFINITE) axis.at[i] = Math.round(axis.at[i]);
  }
  if (axis.exact) {
    const exact = new DataView(bytes(axis.exact).buffer);
    axis.digits = Array.from({ length: N }, (_, i) => exact.getFloat64(8 * i, true));
  }
  axis.title = axis.unit ? `${axis.label} [${axis.unit}]` : axis.label;
}
const parameters = data.axes.filter((a) => a.parameter), figures = data.axes.filter((a) => !a.parameter);
const order = [6, 0, 9, 2, 1, 5, 4, 3, 8, 7]; // back to front: what is rare and bad on top
const shown = data.states.map(() => true);
const counts = data.states.map(() => 0);
for (const s of state) counts[s]++;
let selected = -1, plot = null;

const valueText = (axis, i) => axis.levels && Number.isFinite(axis.at[i]) ? axis.levels[axis.at[i]] : number(axis.at[i]);
// --------------------------------------------------------------- colours
let css = {};
const readColours = () => {
  const style = getComputedStyle(document.documentElement);
  const get = (name) => style.getPropertyValue(name).trim();
  css = {
    ink: get("--ink"), faint: get("--faint"), grid: get("--grid"), pick: get("--pick"), card: get("--card"),
    states: data.classes.map((c) => get(`--state-${c.replaceAll("_", "-")}`)),
  };
};
const scaleOf = (axis) => {
  const low = axis.low >= 0 && axis.low < 0.5 * axis.high ? 0 : axis.low;
  return { low, high: axis.limit !== null && axis.limit > low ? axis.limit : axis.high };
};
const shade = (axis, v) => {
  if (Number.isNaN(v)) return null;
  if (axis.limit !== null && v > axis.limit) return css.states[1];
  const { low, high } = scaleOf(axis);
  return ramp((v - low) / (high - low || 1));
};

const mark = (c, s, x, y, r, fill) => {
  c.beginPath();
  shapes[data.classes[s]](c, x, y, r);
  c.fillStyle = fill;
  c.fill();
};

// ------------------------------------------------------------------ axes
const ticksOf = (axis, room) => {
  if (axis.levels) {
    const step = Math.max(1, Math.ceil(axis.levels.length / room));
    return axis.levels.map((text, k) => [k, text]).filter(([k]) => k % step === 0);
  }
  const span = axis.high - axis.low, rough = span / room, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough), found = [];
  for (let v = Math.ceil(axis.low / step) * step; v <= axis.high + 1e-9 * span; v += step) found.push([v, number(Math.abs(v) < 1e-9 * step ? 0 : +v.toPrecision(10))]);
  return found;
};
const spanOf = (axis) => {
  if (axis.levels) return [-.5, axis.levels.length - .5];
  const pad = choose.view.value === "points" ? .025 * (axis.high - axis.low) : 0;
  return [axis.low - pad, axis.high + pad];
};
// The same small shift for the same run every time, so that equal levels do not hide each other.
const shift = (i, salt) => { const t = Math.sin(i * 12.9898 + salt * 78.233) * 43758.5453; return (t - Math.floor(t) - .5) * .62; };
const placeOf = (axis, i, salt) => {
  const v = axis.at[i];
  if (v === Infinity) return axis.high;
  if (v === -Infinity) return axis.low;
  return axis.levels ? v + shift(i, salt) : v;
};
const axisOf = (key) => data.axes.find((a) => a.key === key);

// ----------------------------------------------------------------- cells
const cellCount = (axis) => axis.levels ? axis.levels.length : data.pairs ? data.cells : Math.max(4, Math.min(data.cells, Math.round(Math.sqrt(N) / 1.5)));
const cellAt = (axis, i) => {
  const v = axis.at[i], n = cellCount(axis);
  if (Number.isNaN(v)) return -1;
  if (axis.levels) return v;
  return Math.min(Math.max(Math.floor((v - axis.low) / (axis.high - axis.low) * n), 0), n - 1);
};
const cellsOf = (x, y) => {
  const w = cellCount(x), h = cellCount(y), kinds = data.states.length;
  const cells = Array.from({ length: w * h }, () => ({ counts: new Array(kinds).fill(0), rows: [], total: 0 }));
  for (let i = 0; i < N; i++) {
    const a = cellAt(x, i), b = cellAt(y, i);
    if (a >= 0 && b >= 0) { cells[b * w + a].rows.push(i); cells[b * w + a].counts[state[i]]++; }
  }
  const exact = pairOf(x, y);
  if (exact) {
    const all = unpack(exact.text);
    for (let b = 0; b < h; b++) for (let a = 0; a < w; a++) {
      const at = exact.swapped ? a * h + b : b * w + a;
      cells[b * w + a].counts = all.slice(at * kinds, (at + 1) * kinds);
    }
  }
  for (const cell of cells) cell.total = cell.counts.reduce((p, q) => p + q, 0);
  return { w, h, cells, exact: !data.pairs || !!exact };
};
const pairOf = (x, y) => {
  const i = data.axes.indexOf(x), j = data.axes.indexOf(y);
  const text = data.pairs && data.pairs[`${Math.min(i, j)},${Math.max(i, j)}`];
  return text ? { text, swapped: i > j } : null; // the lower index runs fastest
};

// --------------------------------------------------------------- drawing
const draw = () => {
  readColours();
  const x = axisOf(choose.x.value), y = axisOf(choose.y.value), colour = axisOf(choose.colour.value) || null;
  const width = canvas.parentElement.clientWidth, height = Math.round(Math.max(300, Math.min(520, width * .62)));
  const ratio = Math.min(window.devicePixelRatio || 1, 3), c = canvas.getContext("2d");
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  canvas.style.height = `${height}px`;
  c.setTransform(ratio, 0, 0, ratio, 0, 0);
  c.clearRect(0, 0, width, height);
  c.font = `12px ${getComputedStyle(document.body).fontFamily}`;
  const yTicks = ticksOf(y, Math.max(3, Math.floor(height / 48)));
  const left = Math.min(Math.ceil(Math.max(...yTicks.map(([, t]) => c.measureText(t).width), 12)) + 34, width * .4);
  const box = { left, top: 10, right: width - 12, bottom: height - 44 };
  const xTicks = ticksOf(x, Math.max(3, Math.floor((box.right - left) / 62)));
  const [x0, x1] = spanOf(x), [y0, y1] = spanOf(y);
  const px = (v) => box.left + (v - x0) / (x1 - x0) * (box.right - box.left);
  const py = (v) => box.bottom - (v - y0) / (y1 - y0) * (box.bottom - box.top);
  c.lineWidth = 1;
  c.strokeStyle = css.grid;
  c.beginPath();
  for (const [v] of xTicks) { c.moveTo(px(v), box.top); c.lineTo(px(v), box.bottom); }
  for (const [v] of yTicks) { c.moveTo(box.left, py(v)); c.lineTo(box.right, py(v)); }
  c.stroke();
  plot = { x, y, colour, box, px, py, points: [], cells: null };
  c.save();
  c.beginPath();
  c.rect(box.left - 5, box.top - 5, box.right - box.left + 10, box.bottom - box.top + 10);
  c.clip();
  (choose.view.value === "cells" ? drawCells : drawPoints)(c, plot);
  c.restore();
  for (const [axis, horizontal] of [[x, false], [y, true]]) {
    if (axis.limit === null || axis.limit < axis.low || axis.limit > axis.high) continue;
    c.strokeStyle = css.ink;
    c.setLineDash([6, 4]);
    c.beginPath();
    if (horizontal) { c.moveTo(box.left, py(axis.limit)); c.lineTo(box.right, py(axis.limit)); }
    else { c.moveTo(px(axis.limit), box.top); c.lineTo(px(axis.limit), box.bottom); }
    c.stroke();
    c.setLineDash([]);
    c.fillStyle = css.ink;
    c.textAlign = horizontal ? "right" : "left";
    c.fillText("limit", horizontal ? box.right - 3 : px(axis.limit) + 4, horizontal ? py(axis.limit) - 5 : box.top + 11);
  }
  c.fillStyle = css.ink;
  c.textAlign = "center";
  c.textBaseline = "top";
  for (const [v, text] of xTicks) c.fillText(text, px(v), box.bottom + 6);
  c.fillText(fit(c, x.title, box.right - box.left), (box.left + box.right) / 2, box.bottom + 25);
  c.textAlign = "right";
  c.textBaseline = "middle";
  for (const [v, text] of yTicks) c.fillText(fit(c, text, left - 26), box.left - 7, py(v));
  c.save();
  c.translate(11, (box.top + box.bottom) / 2);
  c.rotate(-Math.PI / 2);
  c.textAlign = "center";
  c.fillText(fit(c, y.title, box.bottom - box.top), 0, 0);
  c.restore();
  c.textBaseline = "alphabetic";
  canvas.setAttribute("aria-label", `Map of ${plural(data.total, "run")}: ${x.title} to the right, ${y.title} upwards. Arrow keys go from run to run.`);
  note.textContent = noteText(plot);
};
const drawPoints = (c, p) => {
  const r = N > 2000 ? 2.8 : N > 500 ? 3.6 : N > 120 ? 4.6 : 6;
  for (const s of order) {
    if (!shown[s]) continue;
    for (let i = 0; i < N; i++) {
      if (state[i] !== s || Number.isNaN(p.x.at[i]) || Number.isNaN(p.y.at[i])) continue;
      const X = p.px(placeOf(p.x, i, 1)), Y = p.py(placeOf(p.y, i, 2));
      const fill = p.colour ? shade(p.colour, p.colour.at[i]) : css.states[s];
      c.globalAlpha = fill ? .88 : .5;
      mark(c, s, X, Y, fill ? r : .6 * r, fill || css.states[6]);
      p.points.push([X, Y, i]);
    }
  }
  c.globalAlpha = 1;
  const found = p.points.find(([, , i]) => i === selected);
  if (found) {
    c.strokeStyle = css.pick;
    c.lineWidth = 2;
    c.beginPath();
    c.arc(found[0], found[1], r + 5, 0, 7);
    c.stroke();
  }
};
const drawCells = (c, p) => {
  const grid = cellsOf(p.x, p.y), { box } = p;
  p.cells = grid;
  const cw = (box.right - box.left) / grid.w, ch = (box.bottom - box.top) / grid.h, gap = Math.min(cw, ch) > 28 ? 1.5 : .4;
  for (let b = 0; b < grid.h; b++) for (let a = 0; a < grid.w; a++) {
    const cell = grid.cells[b * grid.w + a], X = box.left + a * cw + gap, Y = box.bottom - (b + 1) * ch + gap, W = cw - 2 * gap, H = ch - 2 * gap;
    if (!cell.total) continue;
    if (choose.colour.value === "rate") {
      const answered = cell.counts.reduce((q, n, s) => q + (s < 7 ? n : 0), 0);
      cell.mean = answered ? 100 * cell.counts[0] / answered : NaN;
      c.fillStyle = answered ? ramp(cell.mean / 100) : css.states[6];
      c.fillRect(X, Y, W, H);
      continue;
    }
    if (p.colour) {
      const known = cell.rows.map((i) => p.colour.at[i]).filter((v) => Number.isFinite(v));
      cell.mean = known.length ? known.reduce((q, v) => q + v, 0) / known.length : NaN;
      c.fillStyle = shade(p.colour, cell.mean) || css.states[6];
      c.globalAlpha = known.length ? 1 : .35;
      c.fillRect(X, Y, W, H);
      c.globalAlpha = 1;
      continue;
    }
    const total = cell.counts.reduce((q, n, s) => q + (shown[s] ? n : 0), 0);
    let at = X;
    cell.counts.forEach((n, s) => {
      if (!n || !shown[s]) return;
      c.fillStyle = css.states[s];
      c.fillRect(at, Y, W * n / total + .3, H);
      at += W * n / total;
    });
    const text = `${cell.counts[0]}/${cell.total}`;
    if (total && H > 17 && c.measureText(text).width < W - 6) {
      c.textAlign = "center";
      c.textBaseline = "middle";
      c.fillStyle = css.card;
      c.globalAlpha = .82;
      const room = c.measureText(text).width + 8;
      c.fillRect(X + W / 2 - room / 2, Y + H / 2 - 8, room, 16);
      c.globalAlpha = 1;
      c.fillStyle = css.ink;
      c.fillText(text, X + W / 2, Y + H / 2 + .5);
      c.textBaseline = "alphabetic";
    }
  }
};
const noteText = (p) => {
  const parts = [];
  if (choose.view.value === "cells") {
    parts.push(choose.colour.value === "rate" ? "Colour: share of the runs with an answer that pass; a refusal does not." : p.colour ? `Colour: mean of ${p.colour.label} over the completed runs of a cell.` : "A cell is filled by the shares of its runs; the numbers are passed / all.");
    if (data.pairs && (!p.cells.exact || p.colour)) parts.push(`From the ${N.toLocaleString("en")} runs that are in this page one by one.`);
    else if (data.pairs) parts.push(`Counts of all ${data.total.toLocaleString("en")} runs.`);
  } else {
    if (data.pairs) parts.push(`${N.toLocaleString("en")} of ${data.total.toLocaleString("en")} runs: rare outcomes first, the others drawn at random. “Cells” counts all.`);
    if (p.x.levels || p.y.levels) parts.push("Runs on a level are spread a little, so that none hides another.");
  }
  return parts.join(" ");
};

// ---------------------------------------------------------------- legend
const drawLegend = () => {
  legend.replaceChildren();
  const colour = axisOf(choose.colour.value) || null, rate = choose.colour.value === "rate";
  data.states.forEach((label, s) => {
    if (!counts[s] || ((colour || rate) && choose.view.value === "cells")) return;
    const button = element("button"), icon = element("canvas");
    button.type = "button";
    button.setAttribute("aria-pressed", String(shown[s]));
    icon.width = icon.height = 32;
    const c = icon.getContext("2d");
    if (choose.view.value === "cells") { c.fillStyle = css.states[s]; c.fillRect(4, 4, 24, 24); }
    else mark(c, s, 16, 16, 10, colour ? css.faint : css.states[s]);
    button.append(icon, label);
    button.addEventListener("click", () => { shown[s] = !shown[s]; draw(); drawLegend(); });
    legend.append(button);
  });
  if (colour || rate) {
    const { low, high } = rate ? { low: 0, high: 100 } : scaleOf(colour), bar = element("i"), row = element("span", undefined, "scale");
    bar.style.background = `linear-gradient(90deg, ${CIVIDIS.map((_, k) => ramp(k / (CIVIDIS.length - 1))).join(",")})`;
    row.append(element("span", number(low, 3)), bar, element("span", `${withUnit(number(high, 3), rate ? "% pass" : colour.unit)}${colour && high === colour.limit ? " (limit)" : ""}`));
    if (colour && colour.limit !== null) row.append(element("i", "", "over"), element("span", "over the limit"));
    legend.append(row);
  }
};

// --------------------------------------------------------------- details
const headOf = (i) => `run ${data.name[i]}: ${data.states[state[i]]}`;
const whyOf = (i) => {
  const cause = data.cause && data.cause[i], reason = data.reasons[data.reason[i]];
  if (cause) return cause;
  return reason ? reason.replaceAll("_", " ") : "";
};
const failedOf = (i) => data.faileds[data.failed[i]].split(",").filter(Boolean);
const command = (i) => {
  if (!parameters.every((a) => a.digits || a.levels)) return "";
  const quote = (t) => /^[\w.+-]+$/.test(t) ? t : `'${t}'`;
  const set = parameters.map((a) => `--set ${a.key}=${quote(a.digits ? String(a.digits[i]).replace("Infinity", "inf") : a.levels[a.at[i]])}`);
  return [data.repeat.start, ...set, data.repeat.end].filter(Boolean).join(" ");
};
const pick = (i) => {
  selected = i;
  picked.replaceChildren();
  const head = element("p");
  const chip = element("i", undefined, "chip");
  chip.style.background = `var(--state-${data.classes[state[i]].replaceAll("_", "-")})`;
  head.append(chip, element("b", headOf(i)));
  const link = data.links[i];
  if (link) for (const [text, address] of link) { const a = element("a", text); a.href = address; head.append(" · ", a); }
  picked.append(head);
  const why = whyOf(i);
  if (why) picked.append(element("p", why));
  const failed = new Set(failedOf(i).map((name) => `metric:${name}`));
  const list = element("ul");
  for (const axis of [...parameters, ...figures]) {
    if (!axis.parameter && Number.isNaN(axis.at[i])) continue;
    const item = element("li", undefined, failed.has(axis.key) || (axis.limit !== null && axis.at[i] > axis.limit) ? "bad" : "");
    const limit = axis.limit !== null && !axis.parameter && axis.key !== "used" ? ` of ${number(axis.limit, 3)}` : "";
    const value = axis.digits ? number(axis.digits[i], 6) : valueText(axis, i);
    item.append(element("span", axis.label), element("b", withUnit(value + limit, axis.unit)));
    list.append(item);
  }
  picked.append(list);
  const line = command(i);
  if (line) {
    const row = element("div", undefined, "repeat"), button = element("button", "copy", "copy");
    button.type = "button";
    button.addEventListener("click", () => {
      if (navigator.clipboard) navigator.clipboard.writeText(line).then(() => { button.textContent = "copied"; }, () => {});
    });
    row.append(element("code", line));
    if (navigator.clipboard) row.append(button);
    picked.append(row);
  }
  draw();
};
const pickCell = (cell) => {
  picked.replaceChildren(element("p", cellText(cell).join(" · ")));
  const rows = cell.rows.slice().sort((a, b) => order.indexOf(state[b]) - order.indexOf(state[a])).slice(0, 24), row = element("p");
  rows.forEach((i) => {
    const link = element("button", data.name[i], "copy");
    link.type = "button";
    link.title = headOf(i);
    link.style.borderColor = css.states[state[i]];
    link.addEventListener("click", () => pick(i));
    row.append(link, " ");
  });
  if (cell.total > rows.length) row.append(`and ${(cell.total - rows.length).toLocaleString("en")} more`);
  picked.append(row);
};
const cellText = (cell) => {
  const lines = [plural(cell.total, "run")];
  cell.counts.forEach((n, s) => { if (n) lines.push(`${data.states[s]} ${n.toLocaleString("en")} (${Math.round(100 * n / cell.total)} %)`); });
  if (plot.colour) lines.push(`mean ${plot.colour.label}: ${withUnit(number(cell.mean, 3), plot.colour.unit)}`);
  return lines;
};

// ----------------------------------------------------------- interaction
const at = (event) => {
  const r = canvas.getBoundingClientRect();
  return [event.clientX - r.left, event.clientY - r.top];
};
const nearest = (X, Y, reach) => {
  let best = -1, least = reach * reach;
  for (const [a, b, i] of plot.points) { const d = (a - X) ** 2 + (b - Y) ** 2; if (d <= least) { least = d; best = i; } }
  return best;
};
const cellUnder = (X, Y) => {
  const { box, cells } = plot;
  if (!cells || X < box.left || X >= box.right || Y <= box.top || Y > box.bottom) return null;
  const a = Math.floor((X - box.left) / (box.right - box.left) * cells.w), b = Math.floor((box.bottom - Y) / (box.bottom - box.top) * cells.h);
  const cell = cells.cells[Math.min(b, cells.h - 1) * cells.w + Math.min(a, cells.w - 1)];
  return cell.total ? cell : null;
};
const showTip = (lines, X, Y) => {
  tip.replaceChildren(...lines.filter(Boolean).map((line, k) => { const row = element("div"); row.append(k ? line : element("b", line)); return row; }));
  tip.hidden = false;
  const room = canvas.clientWidth - tip.offsetWidth - 4;
  tip.style.left = `${Math.max(0, Math.min(X + 14, room))}px`;
  tip.style.top = `${Y + 16 + tip.offsetHeight > canvas.clientHeight ? Math.max(0, Y - tip.offsetHeight - 10) : Y + 16}px`;
};
canvas.addEventListener("pointermove", (event) => {
  const [X, Y] = at(event);
  const cell = cellUnder(X, Y), i = cell ? -1 : nearest(X, Y, 14);
  if (cell) showTip(cellText(cell), X, Y);
  else if (i >= 0) {
    const lines = [headOf(i), ...[plot.x, plot.y, plot.colour].filter(Boolean).map((a) => `${a.label} = ${withUnit(valueText(a, i), a.unit)}`)];
    const failed = failedOf(i);
    if (failed.length) lines.push(`out of tolerance: ${failed.slice(0, 3).map((name) => data.metrics[name] || name).join("; ")}${failed.length > 3 ? " …" : ""}`);
    showTip([...lines, whyOf(i).slice(0, 120)], X, Y);
  } else tip.hidden = true;
});
canvas.addEventListener("pointerleave", () => { tip.hidden = true; });
canvas.addEventListener("click", (event) => {
  const [X, Y] = at(event), cell = cellUnder(X, Y);
  if (cell) { if (cell.rows.length === 1) pick(cell.rows[0]); else pickCell(cell); return; }
  const i = nearest(X, Y, 22);
  if (i >= 0) pick(i);
});
canvas.addEventListener("keydown", (event) => {
  const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
  if (!step) return;
  event.preventDefault();
  pick(((selected < 0 ? (step > 0 ? -1 : 0) : selected) + step + N) % N);
});

// ----------------------------------------------------------------- start
const option = (axis) => { const made = element("option", axis.title); made.value = axis.key; return made; };
const group = (label, axes) => { const made = element("optgroup"); made.label = label; made.append(...axes.map(option)); return made; };
for (const select of [choose.x, choose.y]) {
  select.append(group("parameters", parameters));
  if (figures.length) select.append(group("figures", figures));
}
const byOutcome = element("option", "outcome");
byOutcome.value = "";
const byRate = element("option", "share that passes (cells)");
byRate.value = "rate";
choose.colour.append(byOutcome, byRate);
if (figures.length) choose.colour.append(group("figures", figures));
for (const [value, text] of [["points", "points"], ["cells", "cells"]]) { const made = element("option", text); made.value = value; choose.view.append(made); }
choose.x.value = parameters[0].key;
choose.y.value = (parameters[1] || figures[0] || parameters[0]).key;
const suit = () => {
  const x = axisOf(choose.x.value), y = axisOf(choose.y.value);
  choose.view.value = (x.levels && y.levels) || (data.pairs && pairOf(x, y)) ? "cells" : "points";
};
if (data.pairs && pairOf(axisOf(choose.x.value), axisOf(choose.y.value))) choose.colour.value = "rate";
const update = () => { tip.hidden = true; draw(); drawLegend(); };
suit();
for (const select of [choose.x, choose.y]) select.addEventListener("change", () => { suit(); update(); });
choose.colour.addEventListener("change", () => { if (choose.colour.value === "rate") choose.view.value = "cells"; update(); });
choose.view.addEventListener("change", () => { if (choose.view.value === "points" && choose.colour.value === "rate") choose.colour.value = ""; update(); });
root.hidden = false;
update();
document.getElementById("map-still").hidden = true;
let last = canvas.parentElement.clientWidth;
new ResizeObserver(() => { const now = canvas.parentElement.clientWidth; if (now !== last) { last = now; draw(); } }).observe(canvas.parentElement);
for (const query of ["(prefers-color-scheme: dark)", "print"]) matchMedia(query).addEventListener("change", update);
