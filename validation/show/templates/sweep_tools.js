// What the map's script needs and knows nothing of a sweep; both run in one scope of their own.
const INFINITE = 65534, ABSENT = 65535, TOP = 65533;
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

// ------------------------------------------------------------------ text
const number = (v, digits = 4) => {
  if (Number.isNaN(v) || v === undefined || v === null) return "–";
  if (!Number.isFinite(v)) return v > 0 ? "inf" : "−inf";
  if (v !== 0 && (Math.abs(v) < 1e-3 || Math.abs(v) >= 1e6)) return v.toExponential(digits - 2).replace("-", "−");
  return String(+v.toPrecision(digits)).replace("-", "−");
};
const withUnit = (text, unit) => unit && text !== "–" ? `${text} ${unit}` : text;
const element = (tag, text, name) => {
  const made = document.createElement(tag);
  if (text !== undefined) made.textContent = text;
  if (name) made.className = name;
  return made;
};
const plural = (n, word) => `${n.toLocaleString("en")} ${word}${n === 1 ? "" : "s"}`;

// --------------------------------------------------------------- colours
// cividis: the same to eyes with and without red-green deficiency, and even in lightness
const CIVIDIS = [[0, 34, 78], [53, 69, 108], [102, 105, 112], [148, 142, 119], [200, 184, 102], [254, 232, 56]];
const ramp = (share) => {
  const t = Math.min(Math.max(share, 0), 1) * (CIVIDIS.length - 1), k = Math.min(Math.floor(t), CIVIDIS.length - 2);
  return `rgb(${CIVIDIS[k].map((c, j) => Math.round(c + (CIVIDIS[k + 1][j] - c) * (t - k))).join(" ")})`;
};

// ---------------------------------------------------------------- shapes
const shapes = {
  pass: (c, x, y, r) => c.arc(x, y, r, 0, 7),
  out_of_tolerance: (c, x, y, r) => c.rect(x - .88 * r, y - .88 * r, 1.76 * r, 1.76 * r),
  not_measured: (c, x, y, r) => polygon(c, x, y, 1.2 * r, 4, 0),
  fell: (c, x, y, r) => polygon(c, x, y, 1.3 * r, 3, Math.PI / 2),
  diverged: (c, x, y, r) => polygon(c, x, y, 1.3 * r, 3, -Math.PI / 2),
  infeasible: (c, x, y, r) => cross(c, x, y, 1.15 * r, Math.PI / 4),
  refused: (c, x, y, r) => c.arc(x, y, .6 * r, 0, 7),
  crashed: (c, x, y, r) => cross(c, x, y, 1.25 * r, 0),
  timed_out: (c, x, y, r) => star(c, x, y, 1.45 * r),
  interrupted: (c, x, y, r) => polygon(c, x, y, 1.2 * r, 5, -Math.PI / 2),
};
function polygon(c, x, y, r, n, start) {
  for (let k = 0; k < n; k++) c[k ? "lineTo" : "moveTo"](x + r * Math.cos(start + 2 * Math.PI * k / n), y + r * Math.sin(start + 2 * Math.PI * k / n));
  c.closePath();
}
function star(c, x, y, r) {
  for (let k = 0; k < 10; k++) {
    const q = k % 2 ? .45 * r : r, a = -Math.PI / 2 + Math.PI * k / 5;
    c[k ? "lineTo" : "moveTo"](x + q * Math.cos(a), y + q * Math.sin(a));
  }
  c.closePath();
}
function cross(c, x, y, r, turn) {
  const w = .36 * r, points = [[-w, -r], [w, -r], [w, -w], [r, -w], [r, w], [w, w], [w, r], [-w, r], [-w, w], [-r, w], [-r, -w], [-w, -w]];
  points.forEach(([a, b], k) => c[k ? "lineTo" : "moveTo"](x + a * Math.cos(turn) - b * Math.sin(turn), y + a * Math.sin(turn) + b * Math.cos(turn)));
  c.closePath();
}

// ---------------------------------------------------------------- packing
const unpack = (text) => {
  const raw = bytes(text), found = [];
  for (let k = 0; k < raw.length;) {
    let v = 0, s = 1;
    while (raw[k] > 127) { v += (raw[k++] & 127) * s; s *= 128; }
    found.push(v + raw[k++] * s);
  }
  return found;
};
const fit = (c, text, room) => {
  if (c.measureText(text).width <= room) return text;
  while (text.length > 1 && c.measureText(`${text}…`).width > room) text = text.slice(0, -1);
  return `${text}…`;
};
