// Tables that sort: real buttons in the headings, aria-sort, and a line that explains the column.

const explained = (metric) => [h("b", {}, metric.label), ": ", metric.explanation];

// `below` gives rows that stay below theirs however the table is sorted.
// columns: {key, label, unit, cell(row), value(row) or null, left, first, explain: nodes, start: "descending" | "ascending"}
const sortable = ({ caption, columns, rows, state, className = "", rowClass = () => null, onSort = () => {}, below = () => [] }) => {
  const body = h("tbody");
  const explanation = h("p", { class: "explain", "aria-live": "polite" });
  const heads = new Map();
  const fill = () => {
    const column = columns.find((one) => one.key === state.key) ?? (state.key ? columns[0] : null);
    const turn = state.direction === "ascending" ? 1 : -1;
    const rank = (row) => column.value(row) ?? null;
    const sorted = !column ? rows : [...rows].sort((a, b) => {
      const [x, y] = [rank(a), rank(b)];
      if (x === null || y === null) return (x === null) - (y === null);
      return turn * (typeof x === "string" ? x.localeCompare(y) : x - y);
    });
    body.replaceChildren(...sorted.flatMap((row) => [row, ...below(row)]).map((row) => h("tr", { class: rowClass(row) }, columns.map((one) => one.cell(row)))));
    for (const [key, head] of heads) key === column?.key ? head.setAttribute("aria-sort", state.direction) : head.removeAttribute("aria-sort");
    explanation.replaceChildren(...(column?.explain ?? []));
  };
  const head = (column) => {
    const label = [h("span", { class: "label" }, column.label), column.unit ? h("span", { class: "unit" }, column.unit) : null];
    const cell = h("th", { scope: "col", class: [column.left ? "left" : "", column.className ?? ""].join(" ").trim() || null });
    if (!column.value) { cell.append(...label.filter(Boolean)); return cell; }
    heads.set(column.key, cell);
    cell.append(h("button", {
      class: "sort", type: "button", "data-sort": column.key,
      onclick: () => {
        state.direction = state.key === column.key ? (state.direction === "ascending" ? "descending" : "ascending") : column.start ?? "descending";
        state.key = column.key;
        fill();
        onSort();
      },
    }, label));
    return cell;
  };
  const table = h("table", { class: className }, h("caption", {}, h("span", {}, caption)), h("thead", {}, h("tr", {}, columns.map(head))), body);
  fill();
  return { element: h("div", {}, h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption }, table), explanation), fill };
};

// The interval of a mean as a bar on an axis that all rows share.
// From where to where bars are drawn. Doing nothing, and one in three at most of the others that lie far from the rest, would press these together:
// they get an arrow and the words "off scale". Only at the worse end: who leads is always on the scale. `agents` are the names of the estimates.
const barRange = (estimates, agents = [], better = "high") => {
  const known = estimates.map((one, i) => ({ ...one, agent: agents[i] })).filter((one) => one.mean !== null), awake = known.filter((one) => one.agent !== NOTHING);
  const kept = (awake.length > 1 ? awake : known).sort((a, b) => a.mean - b.mean), span = (list) => list.at(-1).mean - list[0].mean;
  if (!kept.length) return [0, 0];
  const fewest = kept.length - Math.floor(kept.length / 3), without = (list, k) => (better === "high" ? list.slice(k) : list.slice(0, list.length - k));
  let rest = kept;
  for (let k = 1; k <= rest.length - fewest; k++) if (span(without(rest, k)) > 0 && span(rest) > 2 * span(without(rest, k))) [rest, k] = [without(rest, k), 0];
  return [Math.min(...rest.map((one) => one.low)), Math.max(...rest.map((one) => one.high))];
};

const bar = ({ mean: center, low, high }, [from, to], agent, isRange = false) => {
  if (center === null) return null;
  const place = (value) => `${to > from ? 5 + (90 * (value - from)) / (to - from) : 50}%`;
  const width = to > from ? `${(90 * (high - low)) / (to - from)}%` : "0";
  if (to > from && (center < from || center > to)) return h("span", { class: `bar off ${center < from ? "below" : "above"}`, "aria-hidden": "true", "data-agent": agent, style: { "--colour": colourOf(agent) } }, h("b", {}), h("small", {}, "off scale"));
  return h("span", { class: "bar", "aria-hidden": "true", "data-agent": agent, style: { "--colour": colourOf(agent) } },
    high > low ? h("i", { class: isRange ? "range" : null, style: { left: place(low), width } }) : null, h("b", { style: { left: place(center) } }));
};

// `left` names the places of columns that hold words.
const plainTable = (caption, heads, rows, left = [0]) => h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption },
  h("table", {}, h("caption", {}, h("span", {}, caption)),
    h("thead", {}, h("tr", {}, heads.map((head, i) => h("th", { scope: "col", class: left.includes(i) ? "left" : null }, head)))),
    h("tbody", {}, rows.map((row) => h("tr", {}, row.map((cell, i) => (i ? h("td", { class: left.includes(i) ? "left wrap" : null }, cell) : h("th", { scope: "row" }, cell))))))));

const swatch = (agent) => h("span", { class: `swatch round-${cycleOf(agent)}`, "aria-hidden": "true", "data-agent": agent, style: { "--colour": colourOf(agent) } });
const tag = (text, kind = "") => h("span", { class: `tag ${kind}`.trim() }, text);
