// The map of a sweep's report: Vega-Lite draws it; this script selects axes and shows the selected run.
const data = JSON.parse(document.getElementById("map-data").textContent);
const root = document.getElementById("map-live");
const $ = (name) => root.querySelector(`[data-part="${name}"]`);
const { axes, columns } = data;
const runs = columns.row.map((_, i) => Object.fromEntries(Object.entries(columns).map(([name, values]) => [name, values[i]])));
const [parameters, metrics] = [true, false].map((kind) => axes.filter((a) => a.parameter === kind));
const axisOf = (part) => axes.find((a) => a.key === $(part).value);
const element = (tag, text, name) => Object.assign(document.createElement(tag), { textContent: text ?? "", className: name ?? "" });
const number = (value) => typeof value === "number" ? +value.toPrecision(6) : value ?? "–";

// ---------------------------------------------------------------- specification
const scaleOf = (axis) => ({ scheme: "cividis", clamp: true, ...(axis.limit ? { domain: [0, axis.limit] } : {}) });
const legendOf = (axis) => ({ title: `${axis.label}${axis.unit && ` [${axis.unit}]`}${axis.limit === null ? "" : "; beyond its limit orange"}` });
const colourOf = (axis, field) => ({
  condition: [
    { test: `!isValid(datum.${field})`, value: "var(--state-refused)" },
    ...(axis.limit === null ? [] : [{ test: `datum.${field} > ${axis.limit}`, value: "var(--state-out-of-tolerance)" }]),
  ],
  field, type: "quantitative", scale: scaleOf(axis), legend: legendOf(axis),
});
const limits = (x, y) => [["x", x], ["y", y]].filter(([, a]) => a.limit !== null)
  .map(([name, a]) => ({ mark: { type: "rule", clip: true }, encoding: { [name]: { datum: a.limit, type: "quantitative" } } }));

const points = (x, y, colour) => {
  const [layer] = structuredClone(data.spec.layer);
  Object.assign(layer.encoding, x.x, y.y);
  if (colour) layer.encoding.color = colourOf(colour, colour.field);
  layer.encoding.tooltip = [
    { field: "run" }, { field: "outcome" }, ...[...new Set([x, y, colour])].filter(Boolean).map((a) => ({ field: a.field, title: a.label })),
    { field: "why" }];
  return { ...data.spec, data: { values: runs }, layer: [layer, ...limits(x, y)] };
};
const rate = { key: "rate", field: "pass", label: "share that passes (cells)", unit: "", parameter: false, limit: null };
const cells = (x, y, colour) => {
  const cell = ["x0", "x01", "y0", "y01"];
  const bin = (a, name) => a.levels ? { calculate: `datum.${a.field}`, as: name } : { bin: { maxbins: 16 }, field: a.field, as: [name, `${name}1`] };
  const side = (a, name) => a.levels
    ? { [name]: { ...a[name][name], field: `${name}0` } }
    : { [name]: { field: `${name}0`, bin: "binned", type: "quantitative", title: a[name][name].title, scale: { zero: false, nice: false } }, [`${name}2`]: { field: `${name}01` } };
  const middle = (a, name) => a.levels ? side(a, name) : { [name]: { ...side(a, name)[name], field: `${name}m`, bin: undefined } };
  const sum = (...names) => names.map((name) => ({ op: "sum", field: name, as: name }));
  const scale = { scheme: "cividis", domain: [0, 1] }, { color } = data.spec.layer[0].encoding;
  const filled = !colour ? color : colour !== rate ? colourOf(colour, "value")
    : { field: "value", type: "quantitative", scale, legend: { title: "share of the runs with an answer that pass", format: ".0%" } };
  const tooltip = [{ field: "pass" }, { field: "all", title: "runs with an answer" }, { field: "outcome", title: "most" },
    ...(colour ? [{ field: "value", title: `mean ${colour.label}`, format: ".3~g" }] : [])];
  const sides = { ...side(x, "x"), ...side(y, "y") }, centre = { ...middle(x, "x"), ...middle(y, "y"), text: { field: "share" } };
  return {
    ...data.spec,
    data: { values: runs },
    transform: [
      bin(x, "x0"), bin(y, "y0"), { filter: "isValid(datum.x0) && isValid(datum.y0)" },
      { aggregate: [{ op: "count", as: "n" }, { op: "valid", field: "pass", as: "all" }, ...sum("pass"),
        { op: "sum", field: (colour ?? rate).field, as: "sum" }, { op: "valid", field: (colour ?? rate).field, as: "valid" }], groupby: [...cell, "outcome"] },
      { aggregate: [{ op: "argmax", field: "n", as: "most" }, ...sum("all", "pass", "sum", "valid")], groupby: cell },
      { calculate: "datum.most.outcome", as: "outcome" }, { calculate: "datum.valid ? datum.sum / datum.valid : null", as: "value" },
      { calculate: "datum.pass + '/' + datum.all", as: "share" },
      { calculate: "(+datum.x0 + +datum.x01) / 2", as: "xm" }, { calculate: "(+datum.y0 + +datum.y01) / 2", as: "ym" }],
    layer: [
      { mark: { type: "rect", invalid: "show", stroke: "var(--card)", strokeWidth: 1 }, encoding: { ...sides, tooltip, color: filled } },
      ...(colour ? [] : [{ mark: { type: "text", stroke: "var(--card)", strokeWidth: 3 }, encoding: centre }]), // a halo
      { mark: "text", encoding: colour ? { ...centre, color: { condition: { test: `isValid(datum.value) && datum.value < ${.5 * (colour.limit ?? 1)}`, value: "#fff" }, value: "#000" } } : centre },
    ],
  };
};

// ---------------------------------------------------------------- selected run
const quote = (value) => /^[\w.+-]+$/.test(value) ? value : `'${value}'`;
const show = (run) => {
  const head = element("p"), list = element("ul"), command = [data.repeat[0]];
  head.append(element("b", `run ${run.run}: ${run.outcome}`));
  for (const [label, address] of data.links[run.row] ?? []) head.append(" · ", Object.assign(element("a", label), { href: address }));
  for (const axis of axes) {
    const value = run[axis.field], item = element("li", "", axis.limit !== null && value > axis.limit ? "bad" : "");
    if (axis.parameter && value !== null) command.push(`--set ${axis.key}=${quote(value)}`);
    if (!axis.parameter && value === null) continue;
    item.append(element("span", axis.label), element("b", `${number(value)}${axis.limit === null ? "" : ` of ${number(axis.limit)}`} ${axis.unit}`));
    list.append(item);
  }
  $("picked").replaceChildren(head, element("p", run.why), list, element("code", [...command, data.repeat[1]].join(" ").trim()));
};
const inside = (axis, value, low, high) => axis.levels ? value === low : value >= low && value <= high;
const showCell = (cell, x, y) => {
  const found = runs.filter((r) => inside(x, r[x.field], cell.x0, cell.x01) && inside(y, r[y.field], cell.y0, cell.y01)).reverse();
  if (found.length === 1) return show(found[0]);
  const row = element("p", `${cell.share} pass: `);
  for (const run of found.slice(0, 24)) row.append(Object.assign(element("button", `${run.run} ${run.outcome}`), { type: "button", onclick: () => show(run) }), " ");
  if (found.length > 24) row.append(`and ${found.length - 24} more`);
  $("picked").replaceChildren(row);
};

let shown = -1; // selected by the keyboard
$("plot").addEventListener("keydown", (event) => {
  const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
  if (!step) return;
  event.preventDefault();
  shown = (Math.max(shown, step < 0 ? 0 : -1) + step + runs.length) % runs.length;
  show(runs[shown]);
});

// ---------------------------------------------------------------- choices
const formatTooltip = (found, clean) => Object.entries(found).filter(([, value]) => value !== "")
  .map(([name, value]) => `<div><span>${clean(name)}</span> ${clean(String(number(value)))}</div>`).join("");
// Vega-Lite's nearest mark takes its tooltip from the wrong datum (as of 6.1).
const patch = (vega) => {
  const tip = vega.marks.find((mark) => mark.name?.endsWith("voronoi"))?.encode.update.tooltip;
  if (tip && !tip.signal.includes("datum.datum")) tip.signal = tip.signal.replaceAll("datum[", "datum.datum[");
  return vega;
};
let view = null;
const draw = async () => {
  const [x, y] = [axisOf("x"), axisOf("y")], colour = $("colour").value === rate.key ? rate : axisOf("colour");
  if (colour === rate) $("view").value = "cells";
  const inCells = $("view").value === "cells";
  const spec = (inCells ? cells : points)(x, y, colour), width = $("plot").clientWidth;
  spec.config = { ...spec.config, legend: { ...spec.config.legend, columns: Math.max(2, Math.floor(width / 125)) } };
  spec.height = Math.max(300, Math.min(470, .58 * width));
  if (!inCells && width < 500) spec.layer[0].encoding.size.value = 26;
  view?.finalize();
  ({ view } = await vegaEmbed($("plot"), spec, { actions: false, renderer: "svg", tooltip: { theme: "page", formatTooltip }, patch }));
  if (inCells) view.addEventListener("click", (_, item) => { if (item?.datum?.share) showCell(item.datum, x, y); });
  else view.addSignalListener("pick", (_, { row }) => { if (row) show(runs.find((r) => r.row === row[0])); });
  $("note").textContent = runs.length < data.total
    ? `${runs.length.toLocaleString("en")} of ${data.total.toLocaleString("en")} runs: a random sample, and rare outcomes, which shares do not count.` : "";
};
const options = (part, label, list) => {
  const group = Object.assign(document.createElement("optgroup"), { label });
  group.append(...list.map((a) => Object.assign(element("option", `${a.label}${a.unit && ` [${a.unit}]`}`), { value: a.key })));
  if (list.length) $(part).append(group);
};
for (const part of ["x", "y"]) { options(part, "parameters", parameters); options(part, "metrics", metrics); }
options("colour", "cells", [rate]);
options("colour", "metrics", metrics);
$("y").value = (axes[1] ?? axes[0]).key;
const suit = () => { $("view").value = axisOf("x").levels && axisOf("y").levels || runs.length < data.total ? "cells" : "points"; };
for (const part of ["x", "y", "colour", "view"]) $(part).addEventListener("change", () => { if (part === "x" || part === "y") suit(); draw(); });
suit();
if (runs.length < data.total) $("colour").value = rate.key;
root.hidden = false;
document.getElementById("map-still").hidden = true;
draw();
