// What the page knows: results, the pieces that are opened when needed, and money at other prices.

// Pieces of the page are compressed; each is opened when it is needed, the one with all results at once.
const opened = new Map();
const unzip = async (name) => {
  const packed = Uint8Array.from(atob(document.getElementById(`block-${name}`).textContent), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).text();
};
const block = (name) => {
  if (!opened.has(name)) opened.set(name, unzip(name).then(JSON.parse));
  return opened.get(name);
};

const D = await block("data");
const TASKS = Object.fromEntries(D.tasks.map((task) => [task.id, task]));
const BY_SHORT = Object.fromEntries(D.tasks.map((task) => [task.short, task]));
// Entries stand in tables and figures; trainings of an entry have pages of their own, and its colour.
const ENTRIES = D.agents.filter((agent) => !agent.training_of);
const AGENTS = Object.fromEntries(ENTRIES.map((agent, index) => [agent.name, { ...agent, index }]));
for (const agent of D.agents) if (agent.training_of) AGENTS[agent.name] = { ...agent, index: AGENTS[agent.training_of].index };
// Names of metrics, of what is sold and bought, and of recorded columns come with the data, task by task; the script goes by their kinds.
const WORDS = D.words.map((words) => {
  const ofKind = (...kinds) => words.metrics.filter((metric) => kinds.includes(metric.kind)), columns = words.metrics.filter((metric) => metric.column);
  return {
    ...words, ofKind, columns, headlines: columns.filter((metric) => metric.interval).map((metric) => metric.name), violations: ofKind("violation"), outside: ofKind("outside")[0]?.name,
    metric: Object.fromEntries(words.metrics.map((metric) => [metric.name, metric])), money: new Set(ofKind("score", "profit", "earned", "paid").map((metric) => metric.name)),
    sold: words.items.filter((item) => item.sign > 0), bought: words.items.filter((item) => item.sign < 0),
  };
});
// Of a task or a suite.
const wordsOf = (one) => WORDS[one.words_of];
const [SCORE, PROFIT, PENALTY] = ["score", "profit", "penalty"].map((kind) => WORDS[0].ofKind(kind)[0].name);

// Profiles count the hours of a day from the first midnight of a run.
const hoursOf = (task) => task.clock + (task.clock_changes ? ", by the clock at the start of the run; after a clock change within the run they are an hour off the local clock" : "");

// What ranks, and what violations cost, inside sentences: points, or money where violations have prices.
const inMoney = (task, name) => Boolean(wordsOf(task).metric[name].unit);
const amountOf = (task, name, value) => withUnit(value, wordsOf(task).metric[name].decimals, wordsOf(task).metric[name].unit);
const moreViolations = (task, gap) => (inMoney(task, PENALTY) ? `violations that cost ${amountOf(task, PENALTY, Math.abs(gap))} ${gap > 0 ? "more" : "less"}` : `a penalty ${amountOf(task, PENALTY, Math.abs(gap))} ${gap > 0 ? "higher" : "lower"}`);

const resultsOf = (taskId) => D.results.filter((result) => result.task === taskId && !result.member_of);
// Trainings of an entry in the order of their seeds; of an agent with one result none.
const trainingsOf = (result) => (result.members ?? []).map((name) => resultOf(result.task, name));
const labelOf = (result) => (result.trainings ? `${result.agent} (${plural(result.trainings, "training")})` : result.agent);
const resultOf = (taskId, agent) => D.results.find((result) => result.task === taskId && result.agent === agent);
const familyOf = (taskId) => D.families.find((family) => family.tasks.includes(taskId));

// Prices that the reader chose, for all tasks with the same words. Where a price changes with the calendar it is the factor 1 of its table, and two
// more numbers: what is added to it, and whether it stays at its mean.
const chosenPrices = {};
const addedTo = (money) => `${money}-plus`, flatOf = (money) => `${money}-flat`;
const taskPrices = (task) => ({ ...task.prices, ...Object.fromEntries(wordsOf(task).items.filter((item) => item.table).flatMap(({ money }) => [[addedTo(money), 0], [flatOf(money), 0]])) });
const pricesOf = (task) => (task.prices ? { ...taskPrices(task), ...chosenPrices[task.words_of] } : null);
const differing = (task) => (chosenPrices[task.words_of] && task.prices ? Object.entries(taskPrices(task)).filter(([name, price]) => pricesOf(task)[name] !== price).map(([name]) => name) : []);
const pricesDiffer = (task) => differing(task).length > 0;

// The mean of a price that changes: of the day where it has hours, else of what was sold or bought here. Null where there is none.
const meanPrice = (task, { money, amount }) => {
  const known = task.mean_prices[money];
  if (known !== null) return known ?? null;
  const runs = resultsOf(task.id).map((result) => result.values).filter((values) => values[money] && values[amount]), of = (name) => sum(runs.map((values) => sum(values[name])));
  return of(amount) ? of(money) / of(amount) : null;
};
// What an item earned or cost in run i. Exact: it is linear in the amount, and in the money at the task's prices, and results hold both.
const moneyAt = (task, prices, item, run, i) => {
  const { money, amount, table } = item;
  const [limit, dear] = task.beyond[money] ?? [Infinity, 0]; // what one pays for the rest
  if (!table) return prices[money] * Math.min(run[amount][i], limit) + dear * Math.max(run[amount][i] - limit, 0);
  return prices[money] * (prices[flatOf(money)] ? meanPrice(task, item) * run[amount][i] : run[money][i]) + prices[addedTo(money)] * run[amount][i];
};

// The scale of the reward's profit: 0 at full use without growth, 1 at full growth without use, unless the task states both.
const scaleAt = (task, prices) => {
  if (task.stated_scale) return { lowest: task.stated_scale[0], span: task.stated_scale[1] - task.stated_scale[0] };
  const { sold, bought } = wordsOf(task), lowest = -sum(bought.map(({ money }) => task.full_use[money] * prices[money]));
  return { lowest, span: sum(sold.map(({ money }) => task.full_growth[money] * prices[money])) - lowest };
};

// Values of one metric in every run, at the prices that hold now. All amounts are linear in them, so nothing is simulated.
// Undefined where the result does not hold the metric, or at other prices not what it follows from.
const valuesOf = (result, metric) => {
  const task = TASKS[result.task], stored = result.values[metric];
  if (!pricesDiffer(task) || !stored) return stored;
  const prices = pricesOf(task), run = result.values, failed = task.failed_step[PROFIT], { items } = wordsOf(task), item = items.find((one) => one.money === metric);
  const held = ({ money, amount, table }) => run[amount] && (!table || run[money]); // what follows from prices
  if (item) return held(item) ? stored.map((_, i) => moneyAt(task, prices, item, run, i)) : undefined;
  if (metric !== PROFIT && metric !== SCORE) return stored;
  if (!items.every(held) || !run[PROFIT]) return undefined;
  const steps = (i) => (result.steps ? result.steps[i] : task.steps);
  const profit = (i) => sum(items.map((one) => one.sign * moneyAt(task, prices, one, run, i)));
  if (metric === PROFIT) return stored.map((_, i) => profit(i) + (task.steps - steps(i)) * failed);
  const isScaled = task.reward_modules.includes("scaled_epi"), [before, now] = isScaled ? [scaleAt(task, taskPrices(task)), scaleAt(task, prices)] : [];
  return stored.map((reward, i) => {
    const earned = run[PROFIT][i] - (task.steps - steps(i)) * failed;
    let changed = reward;
    if (isScaled) changed += (profit(i) - steps(i) * now.lowest) / now.span - (earned - steps(i) * before.lowest) / before.span;
    if (task.reward_modules.includes("epi")) changed += profit(i) - earned;
    return changed;
  });
};

// Values of each training, one row for a single result; and whether the agent was not trained, as far as its results state.
const valuesByTraining = (result, metric) => (result.members ? trainingsOf(result) : [result]).map((one) => valuesOf(one, metric));
const isFixed = (result) => !result.training?.steps;

const UNKNOWN = { mean: null, low: null, high: null };
const remembered = new Map();
// Mean with the ends of its interval: as on the leaderboard, or computed here where prices were changed.
const estimate = (result, metric) => {
  if (!result.estimates[metric]) return UNKNOWN;
  const [center, low, high] = result.estimates[metric];
  if (!wordsOf(TASKS[result.task]).money.has(metric) || !pricesDiffer(TASKS[result.task])) return { mean: center, low, high };
  const key = `${result.task} ${result.agent} ${metric} ${JSON.stringify(chosenPrices)}`;
  if (!valuesOf(result, metric)) return UNKNOWN;
  if (!remembered.has(key)) {
    const means = trainingsOf(result).map((one) => mean(valuesOf(one, metric)));
    const values = valuesOf(result, metric), [from, to] = means.length ? [Math.min(...means), Math.max(...means)] : interval(values);
    remembered.set(key, { mean: mean(values), low: from, high: to });
  }
  return remembered.get(key);
};

// Why an estimate has no interval.
const withoutInterval = (result) => (result.seeds.length === 1 ? "1 run" : "all runs alike");
// What an estimate's ends are, in words: of several trainings a range, else an interval.
const spanWords = (result, { mean: center, low, high }, decimals) => (center === null ? "the result does not state it" : !(high > low) ? `no interval: ${withoutInterval(result)}`
  : result.members ? `lowest to highest of ${plural(result.trainings, "training")}: ${number(low, decimals)} \u2194 ${number(high, decimals)}`
    : `95 % interval over the draws, for this training: ${number(low, decimals)} to ${number(high, decimals)}`);
const spanText = (result, { mean: center, low, high }, decimals) => (center === null ? "not stated" : !(high > low) ? withoutInterval(result) : `${number(low, decimals)} ${result.members ? "\u2194" : "to"} ${number(high, decimals)}`);

// Results of a task with their ranks, best first: as on the leaderboard, or by the metric that ranks at the prices that hold now.
const ranked = (taskId) => {
  const results = resultsOf(taskId);
  if (!pricesDiffer(TASKS[taskId])) return results.map((result) => ({ result, rank: result.rank }));
  const metric = TASKS[taskId].metric, figure = (result) => estimate(result, metric).mean;
  const complete = results.filter((result) => result.rank !== null && valuesOf(result, metric)).sort((a, b) => figure(b) - figure(a));
  const resolution = metric === SCORE && TASKS[taskId].reward_modules.includes("scaled_epi") ? D.resolution : 0;
  const ranks = tierRanks(complete.map((result) => ({ trainings: valuesByTraining(result, metric), fixed: isFixed(result) })), resolution);
  return [...complete.map((result, i) => ({ result, rank: ranks[i] })), ...results.filter((result) => !complete.includes(result)).map((result) => ({ result, rank: null }))];
};

// Whole numbers times a resolution, each as the difference from the known one before it in its row; null where nothing is known.
const unpack = ({ resolution, differences }) => {
  const added = (cells) => {
    let total = 0;
    return cells.map((cell) => (Array.isArray(cell) ? added(cell) : cell === null ? null : (total += cell) * resolution));
  };
  return added(differences);
};
