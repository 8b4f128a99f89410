// Intervals and ranks at prices that the reader enters. The estimates, test, correction and tiers are those of
// glbench/leaderboard/statistics.py; tests/report/test_overall.py compares the ranks.

const lnGamma = (x) => {
  if (x < 7) return lnGamma(x + 1) - Math.log(x);
  const y = 1 / (x * x);
  return (x - 0.5) * Math.log(x) - x + 0.5 * Math.log(2 * Math.PI) + (1 / 12 - y * (1 / 360 - y * (1 / 1260 - y / 1680))) / x;
};

// Regularised incomplete beta function I_x(a, b), by its continued fraction (Lentz).
const incompleteBeta = (x, a, b) => {
  if (x <= 0 || x >= 1) return x <= 0 ? 0 : 1;
  if (x > (a + 1) / (a + b + 2)) return 1 - incompleteBeta(1 - x, b, a);
  let [c, d] = [1, 1 / (1 - ((a + b) * x) / (a + 1))], fraction = d;
  for (let m = 1; m < 500; m++) {
    const before = fraction;
    for (const part of [(m * (b - m) * x) / ((a + 2 * m - 1) * (a + 2 * m)), (-(a + m) * (a + b + m) * x) / ((a + 2 * m) * (a + 2 * m + 1))]) {
      d = 1 / (1 + part * d);
      c = 1 + part / c;
      fraction *= c * d;
    }
    if (Math.abs(fraction / before - 1) < 1e-14) break;
  }
  return (fraction * Math.exp(a * Math.log(x) + b * Math.log(1 - x) + lnGamma(a + b) - lnGamma(a) - lnGamma(b))) / a;
};

// Two-sided p-value of Student's t, and where it is 5 %.
const tailsOf = (t, degrees) => incompleteBeta(degrees / (degrees + t * t), degrees / 2, 0.5);
const criticalT = (degrees) => {
  let [low, high] = [0, 1];
  while (tailsOf(high, degrees) > 0.05) high *= 2;
  for (let i = 0; i < 60; i++) tailsOf((low + high) / 2, degrees) > 0.05 ? (low = (low + high) / 2) : (high = (low + high) / 2);
  return (low + high) / 2;
};

// Degrees of freedom at which the critical value is the mean of two, weighted by variances (Cochran).
const togetherOf = (one, degrees, other, otherDegrees) => {
  const critical = (one * criticalT(degrees) + other * criticalT(otherDegrees)) / (one + other);
  let [low, high] = [Math.min(degrees, otherDegrees), Math.max(degrees, otherDegrees)];
  for (let i = 0; i < 60; i++) tailsOf(critical, (low + high) / 2) > 0.05 ? (low = (low + high) / 2) : (high = (low + high) / 2);
  return (low + high) / 2;
};

const ROUNDING = 1e-12;
const variance = (values) => { const center = mean(values); return sum(values.map((value) => (value - center) ** 2)) / (values.length - 1); };
const overTrainings = (rows) => rows[0].map((_, run) => mean(rows.map((row) => row[run])));
const drawsNothing = (values, scale) => values.length > 1 && Math.max(...values) - Math.min(...values) <= ROUNDING * scale;

// Variance between the trainings of one agent, and its residual part; null for one training.
const betweenTrainings = (rows) => {
  if (rows.length < 2) return null;
  const means = rows.map(mean), runs = overTrainings(rows), all = mean(means), n = runs.length;
  const rest = sum(rows.flatMap((row, k) => row.map((value, i) => (value - means[k] - runs[i] + all) ** 2))) / Math.max((rows.length - 1) * (n - 1), 1) / n;
  return { count: rows.length, one: variance(means), rest };
};

// Mean of the first of `sides` minus that of the second, if any; each has one row of values per training. `fixed`: agents that were not trained.
const estimateMean = (sides, fixed = []) => {
  const averaged = sides.map(overTrainings), runs = averaged[0].map((value, i) => value - (averaged[1]?.[i] ?? 0)), n = runs.length, value = mean(runs);
  const scale = Math.max(...sides.flat(2).map(Math.abs)), same = drawsNothing(runs, scale);
  const overRuns = same || n < 2 ? 0 : variance(runs) / n, runsDegrees = same ? Infinity : n - 1;
  const known = sides.map(betweenTrainings), several = known.filter(Boolean), isDraw = several.length === 1 && known.some((one, i) => !one && !fixed[i]);
  const weight = ({ count }) => 1 / count + (isDraw ? 1 : 0), parts = several.map((one) => [one.one * weight(one), one.count - 1]);
  const between = sum(parts.map(([part]) => part)), rest = sum(several.map((one) => one.rest * weight(one)));
  if (runsDegrees === 0 || !(between > (ROUNDING * scale) ** 2)) return { value, variance: overRuns, degrees: runsDegrees, same };
  const whole = Math.max(between, overRuns, between + overRuns - rest), degrees = 1 / sum(parts.map(([part, count]) => (part / between) ** 2 / count));
  return { value, variance: whole, degrees: overRuns > 0 ? togetherOf(between, degrees, overRuns, runsDegrees) : degrees, same };
};

// 95 % interval of a mean, or of a difference of two.
const intervalOf = ({ value, variance: square, degrees }) => {
  const half = degrees > 0 && square > 0 ? criticalT(degrees) * Math.sqrt(square) : 0;
  return [value - half, value + half];
};
const interval = (values) => intervalOf(estimateMean([[values]]));

// Where nothing is drawn, differences up to `resolution` are rounding.
const pairedTest = (one, other, resolution) => {
  const { value, variance: square, degrees, same } = estimateMean([one.trainings, other.trainings], [one.fixed, other.fixed]);
  if (degrees === 0 || value === 0 || (same && Math.abs(value) <= resolution)) return 1;
  return square > 0 ? tailsOf(value / Math.sqrt(square), degrees) : 0;
};

// P-values corrected for their number (Benjamini and Hochberg).
const correctedValues = (values) => {
  const order = values.map((_, i) => i).sort((a, b) => values[b] - values[a]), adjusted = [];
  order.reduce((least, index, place) => (adjusted[index] = Math.min(least, (values[index] * values.length) / (values.length - place))), 1);
  return adjusted;
};

// Ranks of complete results that are ordered by the mean: those that cannot be told apart from the first of a tier share its rank.
const tierRanks = (rows, resolution) => {
  const pairs = rows.flatMap((_, i) => rows.slice(i + 1).map((_, k) => [i, i + 1 + k]));
  const adjusted = correctedValues(pairs.map(([i, j]) => pairedTest(rows[i], rows[j], resolution))), apart = new Set(pairs.filter((_, k) => adjusted[k] < 0.05).map(String)), ranks = [];
  let first = 0;
  rows.forEach((_, i) => { if (i && apart.has(String([first, i]))) first = i; ranks.push(first + 1); });
  return ranks;
};
