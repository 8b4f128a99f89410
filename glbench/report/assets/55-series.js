// What profiles hold, as charts.

const limitOf = (task, name) => task.limits?.find((limit) => limit.name === name);
const scaled = (rows, factor = 1) => rows.map((row) => row.map((value) => (value === null ? null : value * factor)));
const HOUR_AXIS = { range: [0, 24], tickvals: [0, 6, 12, 18, 24], ticktext: ["0", "6", "12", "18", "24"], title: axisTitle("hour of the day") };
const DAY_TITLE = axisTitle("day");
const captionOf = (label, unit) => [label, unit ? h("span", {}, ` ${unit}`) : null];
// Prices that were changed do not change what was recorded at the task's prices.
const atTaskPrices = (task, name) => (wordsOf(task).series[name].money && pricesDiffer(task) ? " at the task\u2019s prices" : "");

// Amounts begin at 0; where nothing was used there is no scale to find.
const fromZero = (series, values) => (!series?.amount ? {} : values.some((value) => value > 0) ? { rangemode: "tozero" } : { range: [0, 1], tickvals: [0] });

// One quantity by time of day: the 90 % band, the 50 % band, and the median; for several agents at once.
const dayChart = (task, name, courses, slotSeconds) => {
  const words = wordsOf(task).series[name], limit = limitOf(task, name);
  const build = () => {
    const traces = [];
    for (const { agent, packed } of courses) {
      const colour = agent ? colourOf(agent) : variable("accent");
      const rows = scaled(unpack(packed), words.factor), [q05, q25, q50, q75, q95] = rows;
      const hours = q50.map((_, slot) => ((slot + 0.5) * slotSeconds) / 3600);
      const known = hours.map((_, i) => i).filter((i) => q50[i] !== null), pick = (values) => known.map((i) => values[i]);
      if (courses.length === 1) traces.push(band(pick(hours), pick(q05), pick(q95), colour, 0.13));
      traces.push(band(pick(hours), pick(q25), pick(q75), colour, courses.length === 1 ? 0.24 : 0.16));
      traces.push(line(pick(hours), pick(q50), colour, {
        name: agent ? plain(agent) : "median", hovertemplate: `%{y:,.${words.decimals}f}`, line: { dash: courses[0].agent === agent ? "solid" : "dash" },
      }));
    }
    return { traces, layout: layout({ xaxis: HOUR_AXIS, yaxis: { title: axisTitle(words.unit), ...(words.range ? { range: words.range, tickvals: [0, 50, 100] } : fromZero(words, courses.flatMap(({ packed }) => unpack(packed)[4]))) }, shapes: limitShapes(limit) }) };
  };
  const says = courses.map(({ agent, packed }) => {
    const median = scaled(unpack(packed), words.factor)[2].filter((value) => value !== null);
    return median.length ? `${agent ? `${agent}: ` : ""}median between ${number(Math.min(...median), words.decimals)} and ${number(Math.max(...median), words.decimals)} ${words.unit}` : "";
  }).join("; ");
  return chart(captionOf(words.label, words.unit + atTaskPrices(task, name)), build, { height: 180, says: `${words.label} over the day. ${says}${limit ? `; limits ${limit.low} to ${limit.high}` : ""}.` });
};

// One quantity by day of the season: median over the runs, best and worst run; `add` sums up from the start.
const seasonChart = (task, name, packed, agent, { add = false } = {}) => {
  const words = wordsOf(task).series[name], limit = limitOf(task, name);
  const factor = add ? 1 : words.daily_factor ?? words.factor;
  const unit = add ? "EUR/m\u00b2 since the start" : (words.daily ?? `${words.unit}, daily mean`);
  const build = () => {
    const colour = colourOf(agent), days = (task.steps * task.step_seconds) / 86400;
    const x = Array.from({ length: days }, (_, day) => dayOf(task.start, day, SHORT_DATE));
    const running = (values) => { let total = 0; return values.map((value) => (value === null ? null : (total += value))); };
    const [median, best, worst] = scaled(unpack(packed), factor).map((row) => (add ? running(row) : row));
    const digits = add ? 2 : words.daily_decimals ?? words.decimals, one = (label, values, more) => line(x, values, more.colour, { name: label, hovertemplate: `%{y:,.${digits}f}`, line: more.line });
    return {
      traces: [
        ...(differs(worst, median) ? [one("worst run", worst, { colour: variable("warm"), line: { width: 1.2, dash: "dot" } })] : []),
        ...(differs(best, median) ? [one("best run", best, { colour: variable("soft"), line: { width: 1.2, dash: "dash" } })] : []),
        one("median", median, { colour, line: { width: 2.2 } }),
      ],
      layout: layout({ xaxis: { title: DAY_TITLE, nticks: 4, tickangle: 0, tickvals: x.filter((_, day) => day % Math.max(1, Math.ceil(days / 4)) === 0) }, yaxis: { title: axisTitle(add ? "EUR/m\u00b2" : words.daily ?? words.unit), ...fromZero(add ? null : words, [...median, ...best, ...worst]) }, shapes: limitShapes(limit && limitShown(limit, median) ? limit : null) }),
    };
  };
  return chart(captionOf(words.label, unit + atTaskPrices(task, name)), build, { height: 180, says: `${words.label} by day of the season, ${unit}: median over the runs, best and worst run.` });
};
// Whether two curves can be told apart by eye: by more than a hundredth of the height of the chart somewhere.
const differs = (one, other) => {
  const known = [...one, ...other].filter((value) => value !== null), height = Math.max(...known) - Math.min(...known);
  return one.some((value, i) => value !== null && other[i] !== null && Math.abs(value - other[i]) > 0.015 * height);
};
// Limits far from what happened would flatten the curve.
const limitShown = (limit, values) => { const known = values.filter((v) => v !== null); return known.length && Math.max(...known) > limit.high * 0.7; };
