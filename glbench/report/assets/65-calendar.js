// When limits were broken, as a calendar of days and hours; and the worst run, hour by hour, with the reasons.

const calendarPart = (profile, task) => {
  const broken = wordsOf(task).violations.map(({ name, label }) => ({ label, packed: profile.calendar[name.replace("hours_", "")] })).filter(({ packed }) => packed).map(({ label, packed }) => ({ label, minutes: unpack(packed) }))
    .map((limit) => ({ ...limit, total: sum(limit.minutes.flat().filter((value) => value !== null)) / 60 }));
  const shown = broken.filter((limit) => limit.total >= 0.05), kept = broken.filter((limit) => limit.total < 0.05);
  const figure = ({ label, minutes, total }) => {
    const days = minutes.length, byHour = Array.from({ length: 24 }, (_, hour) => minutes.map((day) => day[hour]));
    const labels = minutes.map((_, day) => dayOf(task.start, day, SHORT_DATE));
    const hours = byHour.map((row) => sum(row.filter((value) => value !== null))), dearest = hours.indexOf(Math.max(...hours));
    return chart(captionOf(label, `${number(total, total < 10 ? 1 : 0)} h in the season, most of it around ${clockHour(dearest)}`), () => ({
      traces: [{
        type: "heatmap", z: byHour, x: labels, y: byHour.map((_, hour) => hour), zmin: 0, zmax: 60, showscale: false, xgap: 1, ygap: 1,
        colorscale: [[0, variable("faint")], [0.02, faded(variable("warm"), 0.3)], [1, variable("warm")]], hovertemplate: "%{x}, %{y}:00: %{z:.0f} min<extra></extra>",
      }],
      layout: layout({ hovermode: "closest", xaxis: { title: DAY_TITLE, showgrid: false, tickvals: labels.filter((_, day) => day % Math.max(1, Math.ceil(days / 5)) === 0), tickangle: 0 }, yaxis: { title: axisTitle("hour of the day"), showgrid: false, tickvals: [0, 6, 12, 18], ticktext: ["0", "6", "12", "18"], autorange: "reversed" } }),
    }), { height: 230, says: `${label}: ${number(total, 1)} hours in the season, most of it around ${clockHour(dearest)}.` });
  };
  return [
    h("h2", {}, "When limits were broken"),
    h("p", { class: "soft" }, `Every column is a day${task.start ? "" : " since the start of each run"}, every row an hour (${hoursOf(task)}). The redder a cell, the more of that hour was outside the limit, mean over the runs.`,
      kept.length ? ` Never or hardly ever: ${sentence(kept.map((limit) => lower(limit.label)))}.` : ""),
    shown.length ? h("p", { class: "small soft ramp" }, "0 min", h("span", { "aria-hidden": "true" }), "60 min of the hour outside the limit") : null,
    shown.length ? h("div", { class: "grid two" }, shown.map(figure)) : h("p", {}, "No limit was broken."),
  ];
};

// The day on which violations cost the worst run most.
const hardestDay = (profile) => {
  const hours = unpack(profile.worst[PENALTY]).map((value) => value ?? 0);
  const days = Array.from({ length: Math.floor(hours.length / 24) }, (_, day) => sum(hours.slice(24 * day, 24 * day + 24)));
  const penalty = Math.max(...days);
  return { day: days.indexOf(penalty), penalty };
};

// Why the worst run is the worst: against the mean of all runs, in profit, penalty and hours.
const reasons = (result, task, profile) => {
  const row = result.seeds.indexOf(profile.seeds.worst), of = (metric) => valuesOf(result, metric);
  const gap = (metric) => (of(metric) ? of(metric)[row] - mean(of(metric)) : 0);
  const { items, violations } = wordsOf(task), priced = inMoney(task, SCORE);
  // A score in money may be near 0, so it is measured by all the money that changed hands.
  const behind = -gap(SCORE), whole = priced ? sum(items.map((one) => Math.abs(mean(of(one.money) ?? [0])))) : Math.abs(mean(of(SCORE))), share = (100 * behind) / whole;
  if (result.seeds.length === 1) return [`There is 1 run, that of seed ${profile.seeds.worst}.`];
  if (!(behind > 1e-6 * Math.abs(mean(of(SCORE))))) return ["All runs are alike: there is no worst one. This is the first."];
  const [item] = items.map((one) => [one, one.sign * gap(one.money)]).sort((a, b) => a[1] - b[1])[0] ?? [];
  const worse = violations.map((one) => [one, gap(one.name)]).sort((a, b) => b[1] - a[1])[0] ?? [null, 0];
  const why = [];
  if (item && gap(PROFIT) < 0) why.push(`it earned ${withUnit(-gap(PROFIT), 3, "EUR/m\u00b2")} less, most of it by ${item.sign > 0 ? `less ${lower(item.label)}` : `a dearer bill for ${lower(item.label)}`}`);
  const penaltyText = (value) => (priced ? amountOf(task, PENALTY, value) : number(value, 1));
  if (gap(PENALTY) > 0) why.push(`${priced ? `its violations cost ${penaltyText(gap(PENALTY))} more` : `its penalty was ${penaltyText(gap(PENALTY))} higher`}${worse[1] > 0.05 ? ` (${lower(worse[0].label)} for ${withUnit(worse[1], 1, "h")} longer)` : ""}`);
  const { day, penalty } = hardestDay(profile);
  return [`Seed ${profile.seeds.worst} got a ${lower(wordsOf(task).metric[SCORE].label)} of ${amountOf(task, SCORE, of(SCORE)[row])}, ${priced ? amountOf(task, SCORE, behind) : `${number(behind, behind < 10 ? 1 : 0)} (${number(share, share < 1 ? 2 : 1)} %)`} below the mean of all runs`,
    why.length ? `: ${why.join(", and ")}. ` : ". ", penalty > 0 ? `Its hardest day was ${dayOf(profile.start, day)}, with ${priced ? `violations that cost ${penaltyText(penalty)}` : `a penalty of ${penaltyText(penalty)}`}.` : "",
    share < 1 ? " The runs hardly differ: this is how every run looks." : ""];
};

// The crop as the camera saw it, once a week.
const strip = ({ pictures }) => (pictures ? h("div", { class: "strip" }, pictures.map((src, week) => h("div", { class: "small soft" }, h("img", { src, alt: `Picture of the crop on day ${7 * week + 1}` }), `day ${7 * week + 1}`))) : null);

const worstPart = (result, task, profile) => {
  const { series, panels } = wordsOf(task), has = ({ column, weather }) => (weather ? profile.outside[weather] : profile.worst[column]);
  const course = ({ column, weather }) => (weather ? unpack(profile.outside[weather]) : scaled([unpack(profile.worst[column])], series[column].range ? series[column].factor : 1)[0]);
  const rows = panels.map((panel) => ({ ...panel, lines: panel.lines.filter(has) })).filter((panel) => panel.lines.length).map((panel) => ({ ...panel, lines: panel.lines.map((one) => [one.name, course(one), one.ink, one.decimals ?? 0]) }));
  const { start } = profile, place = (day) => (start ? new Date(Date.parse(`${start}T00:00:00Z`) + 864e5 * day).toISOString().slice(0, 16) : day + 1);
  const hours = rows[0].lines[0][1].map((_, hour) => place((hour + 0.5) / 24));
  const colour = (name) => ({ lamp: colourAt(3), vent: colourAt(2), accent: colourOf(result.agent) })[name] ?? variable(name);
  // The week of the hardest day comes first: a whole season at once shows little.
  const days = (task.steps * task.step_seconds) / 86400, weeks = Math.ceil(days / 7);
  const spanOf = (value) => (value === "all" ? null : [7 * Number(value), Math.min(7 * Number(value) + 7, days)].map(place));
  const hardest = String(Math.floor(hardestDay(profile).day / 7));
  let span = spanOf(hardest);
  const build = () => {
    const traces = [], axes = {}, gap = 0.035, height = (1 - gap * (rows.length - 1)) / rows.length, shapes = [], annotations = [];
    rows.forEach((row, i) => {
      const key = i ? `${i + 1}` : "", top = 1 - i * (height + gap);
      axes[`yaxis${key}`] = axis({ domain: [top - height, top], anchor: "x", nticks: 4, range: row.title.endsWith("%") && !row.limit ? [0, 105] : undefined });
      annotations.push({ xref: "paper", yref: "paper", x: 0, y: top, xanchor: "left", yanchor: "bottom", showarrow: false, text: `<b>${row.title}</b>\u2002${row.lines.length > 1 ? row.lines.map(([name, , ink]) => `<span style="color:${colour(ink)}">${name}</span>`).join("\u2002") : ""}`, font: { color: variable("ink"), size: 12 } });
      for (const [name, y, ink, decimals] of row.lines) traces.push({ ...line(hours, y, colour(ink), { name, hovertemplate: `%{y:,.${decimals}f}`, line: { width: 1.1 } }), yaxis: `y${key}` });
      const limit = task.limits.find((one) => one.name === row.limit);
      for (const shape of limitShapes(limit)) shapes.push({ ...shape, yref: `y${key}`, xref: "x domain" });
    });
    const look = layout({ shapes, annotations, margin: { l: 8, r: 10, t: 22, b: 8 }, dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom", hoversubplots: "axis" });
    return { traces, layout: { ...look, ...axes, xaxis: axis({ ...(start ? { type: "date", title: axisTitle(`day, ${task.clock}`), hoverformat: "%-d %B, %H:%M", tickformat: "%-d %b" } : { title: axisTitle("day of the run"), hoverformat: ".2f" }), fixedrange: false, range: span ?? undefined, anchor: `y${rows.length}`, nticks: 7 }) } };
  };
  const figure = chart(captionOf("Worst run, hour by hour", ""), build, { height: 760, says: `Climate, controls and ${lower(wordsOf(task).metric[PENALTY].label)} of the run with seed ${profile.seeds.worst}, hour by hour.` });
  const drawing = figure.querySelector(".chart");
  const view = select("Show", [{ value: "all", text: "the whole season" }, ...Array.from({ length: weeks }, (_, week) => ({ value: String(week), text: `week ${week + 1}${start ? `, from ${date(start, 7 * week)}` : ""}` }))], hardest, (value) => { span = spanOf(value); redrawChart(drawing); }, "choose-week");
  return [h("h2", {}, "The worst run, and why"), h("p", {}, reasons(result, task, profile)), strip(profile), h("div", { class: "fields" }, view), figure];
};
