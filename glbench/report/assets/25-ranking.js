// Ranks at prices that the reader types: they cannot be computed beforehand. The same test, correction and tiers as glbench/leaderboard/comparisons.py;
// tests/report/test_overall.py holds the two to the same ranks.

// Wilcoxon's signed-rank test of paired differences: exact two-sided p-value, and whom the ranks favour.
const signedRank = (differences) => {
  const known = differences.filter((value) => value !== 0).sort((a, b) => Math.abs(a) - Math.abs(b)), n = known.length;
  if (!n) return { p: 1, favours: 0 };
  const ranks = []; // twice the ranks, so that those shared by ties are whole numbers
  for (let i = 0; i < n; ) {
    let j = i;
    while (j < n && Math.abs(known[j]) === Math.abs(known[i])) j++;
    for (let k = i; k < j; k++) ranks.push(i + 1 + j);
    i = j;
  }
  const total = sum(ranks), above = sum(ranks.filter((_, i) => known[i] > 0)), tail = Math.min(above, total - above);
  let chance = new Float64Array(total + 1);
  chance[0] = 1;
  for (const rank of ranks) {
    const next = new Float64Array(total + 1);
    for (let i = 0; i <= total; i++) next[i] = 0.5 * chance[i] + (i >= rank ? 0.5 * chance[i - rank] : 0);
    chance = next;
  }
  return { p: Math.min(1, 2 * sum([...chance.subarray(0, tail + 1)])), favours: Math.sign(2 * above - total) };
};

const pairedTest = (first, second, metric) => {
  const differences = first.map((value, i) => value - second[i]), gap = differences[0];
  if (differences.some((value) => value !== gap)) return signedRank(differences);
  // A task that draws nothing: no chance to test against, and small differences are rounding.
  return Math.abs(gap) > (metric === SCORE ? D.resolution : 0) ? { p: 0, favours: Math.sign(gap) } : { p: 1, favours: 0 };
};

const holm = (values) => {
  const order = values.map((_, i) => i).sort((a, b) => values[a] - values[b]), corrected = [];
  order.reduce((largest, index, place) => (corrected[index] = Math.max(largest, Math.min(1, (values.length - place) * values[index]))), 0);
  return corrected;
};

// Ranks of complete results that are ordered by the mean: those that cannot be told apart from the first of a tier share its rank.
const tierRanks = (rows, metric) => {
  const pairs = rows.flatMap((_, i) => rows.slice(i + 1).map((_, k) => [i, i + 1 + k]));
  const tests = pairs.map(([i, j]) => pairedTest(rows[i].values, rows[j].values, metric)), corrected = holm(tests.map((test) => test.p));
  const apart = new Set(pairs.filter(([i, j], k) => corrected[k] < 0.05 && tests[k].favours * (rows[i].mean - rows[j].mean) > 0).map(String));
  const ranks = [];
  let first = 0;
  rows.forEach((_, i) => { if (i && apart.has(String([first, i]))) first = i; ranks.push(first + 1); });
  return ranks;
};
