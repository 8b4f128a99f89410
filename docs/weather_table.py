"""Fills the table of generated seasons in docs/weather.md: ``python -m docs.weather_table [--measure]``.

With ``--measure`` the measurements are made again (half a minute): the figures of ``glbench weather statistics``, and a classifier
two-sample test of the joints with the classifiers of scikit-learn (dependency group ``measurements``).
"""

from __future__ import annotations

import datetime as dt
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from docs.tables import with_tables
from glbench.weather import Blocks, SeasonGenerator, load_weather
from glbench.weather.comparison import SPLIT_KEY, Figure, Resemblance, Seasons, daily_values, generated_seasons, resemblance

PAGE = Path(__file__).with_name("weather.md")
MEASUREMENTS = Path(__file__).with_name("measurements") / "weather"
HEADINGS = {
    "training": "2008 to 2010",
    "again": "the same, other draws",
    "test": "2011, 2012",
    "short": "blocks of 1 to 3 days",
    "long": "8 to 16 days",
    "narrow": "window ±6 days",
    "wide": "±20 days",
}
TEST_YEARS = (2011, 2012)
OTHER_BLOCKS = {
    "short": Blocks(shortest=1, longest=3),
    "long": Blocks(shortest=8, longest=16),
    "narrow": Blocks(window=6),
    "wide": Blocks(window=20),
}

HOURS_AROUND_MIDNIGHT = 12
"""Hours on either side of midnight that the classifiers see."""
SIDE_DAYS = 14
"""Days in a row of the record on which a classifier is trained, before as many on which it is tested."""
FEWEST_NIGHTS = 20

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Labels = npt.NDArray[np.bool_]
Classifier = Callable[[Floats, Labels, Floats], Floats]
"""Trained on rows (n, features) and labels (n,), gives scores (m,) of other rows: the higher, the more likely is the label true."""


def logistic(rows: Floats, labels: Labels, others: Floats) -> Floats:
    """Scores by logistic regression with a ridge, on standardised features."""
    from sklearn.linear_model import LogisticRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    classifier = make_pipeline(StandardScaler(), LogisticRegression(max_iter=1000))
    return np.asarray(classifier.fit(rows, labels).decision_function(others))


def boosted(rows: Floats, labels: Labels, others: Floats) -> Floats:
    """Scores by 60 gradient-boosted trees of depth 3."""
    from sklearn.ensemble import HistGradientBoostingClassifier

    classifier = HistGradientBoostingClassifier(
        max_iter=60,
        max_depth=3,
        learning_rate=0.15,
        l2_regularization=5.0,
        max_bins=32,
        min_samples_leaf=1,
        early_stopping=False,
        random_state=0,
    )
    return np.asarray(classifier.fit(rows, labels).decision_function(others))


def joined_nights(seasons: Seasons, seed: int) -> list[Figure]:
    """Whether a classifier can tell joined nights from others: trained on the nights of some weeks of the record, tested on the rest.

    The same days come again in other seasons: split by season, it would only learn the record's own nights by heart.
    No figures where there are too few nights of either kind.
    """
    rows, joined, side = night_rows(seasons)
    rng = np.random.default_rng((seed, SPLIT_KEY, 2))
    joints, others, more = _sample(joined, side, rng)
    if min(one.size for one in joints) < FEWEST_NIGHTS:
        return []
    figures = []
    for classify, most in ((logistic, 0.65), (boosted, 0.75)):
        name = classify.__name__
        found, control = (area(classify, rows, *nights) for nights in ((joints, others), (others, more)))
        figures.append(Figure(f"joined nights found, {name}, AUC [-]", found, None, most))
        figures.append(Figure(f"control, {name}, AUC [-]", control, 0.45, 0.55))
    halves = np.repeat(np.arange(len(seasons.joints)) % 2, seasons.joints.shape[1] - 1)
    joints, others, _ = _sample(joined, halves, rng)
    again = area(boosted, rows, joints, others)
    return [*figures, Figure("the same, having seen the same nights, boosted, AUC [-]", again)]


def night_rows(seasons: Seasons) -> tuple[Floats, Labels, Integers]:
    """What is seen of each night (n, features): changes from hour to hour around midnight, and of the daily values.

    Then whether it is joined (n,), and the side of the record that both its days are from (n,): 1, 0, or -1 where they differ.
    """
    parts = []
    for name, hours in seasons.hours.items():
        if name != "global_radiation":
            before, after = hours[:, :-1, -HOURS_AROUND_MIDNIGHT:], hours[:, 1:, :HOURS_AROUND_MIDNIGHT]
            parts.append(np.diff(np.concatenate([before, after], axis=-1), axis=-1))
    parts += [np.diff(daily, axis=1)[..., None] for daily in daily_values(seasons).values()]
    rows = np.concatenate(parts, axis=-1)
    week = seasons.sources // SIDE_DAYS % 2
    side = np.where(week[:, 1:] == week[:, :-1], week[:, 1:], -1)
    return rows.reshape(-1, rows.shape[-1]), seasons.joints[:, 1:].ravel(), side.ravel()


def _sample(joined: Labels, side: Integers, rng: np.random.Generator) -> tuple[list[Integers], ...]:
    """On side 1 and side 0: the joined nights, as many others, and as many others again."""
    joints = [rng.permutation(np.flatnonzero(joined & (side == one))) for one in (1, 0)]
    plain = [rng.permutation(np.flatnonzero(~joined & (side == one))) for one in (1, 0)]
    both = [(one, other, min(one.size, other.size // 2)) for one, other in zip(joints, plain, strict=True)]
    return [one[:n] for one, _, n in both], [two[:n] for _, two, n in both], [two[n : 2 * n] for _, two, n in both]


def area(classify: Classifier, rows: Floats, ones: list[Integers], zeros: list[Integers]) -> float:
    """Area under the ROC curve on the second nights of ``ones`` and ``zeros``, after training on the first; 0.5 is guessing."""
    from sklearn.metrics import roc_auc_score
    from threadpoolctl import threadpool_limits

    (train, test) = (np.concatenate(both) for both in zip(ones, zeros, strict=True))
    labels = [np.arange(both.size) < one.size for both, one in zip((train, test), ones, strict=True)]
    with threadpool_limits(1):  # sums in the same order on every machine
        scores = classify(rows[train], labels[0], rows[test])
    return float(roc_auc_score(labels[1], scores))


def measure(name: str, **options: Any) -> Resemblance:
    """The measurement ``name``: all figures of the page. ``options`` are those of `resemblance`, to try it with fewer seasons."""
    years = TEST_YEARS if name == "test" else (2008, 2009, 2010)
    generator = SeasonGenerator(load_weather("schiphol"), years, OTHER_BLOCKS.get(name, Blocks()))
    figures = resemblance(generator, seed=2 if name == "again" else 1, **options)
    first = dt.date.fromisoformat(f"2010-{figures.start}")
    seasons = generated_seasons(generator, first, figures.within_days, figures.days, figures.seasons, figures.seed)
    return replace(figures, figures=(*figures.figures, *joined_nights(seasons, figures.seed)))


def read() -> dict[str, Any]:
    """Measurements by name."""
    return {name: json.loads((MEASUREMENTS / f"{name}.json").read_text(encoding="utf-8")) for name in HEADINGS}


def table(measurements: Mapping[str, Any]) -> str:
    """Every figure of every measurement; those that miss their limits are bold."""
    lines = [f"| | limits | {' | '.join(HEADINGS.values())} |", f"|---|---|{'---|' * len(HEADINGS)}"]
    columns = [[Figure(**figure) for figure in measurements[name]["figures"]] for name in HEADINGS]
    for row in zip(*columns, strict=True):
        cells = [figure.text if figure.within_limits else f"**{figure.text}**" for figure in row]
        lines.append(f"| {row[0].name} | {row[0].limits} | {' | '.join(cells)} |")
    return "\n".join(lines)


def filled(page: str, measurements: Mapping[str, Any]) -> str:
    """The page with its table made of the measurements."""
    return with_tables(page, {"seasons": table(measurements)})


def main() -> None:
    """Measure, if asked to, and fill the table."""
    if "--measure" in sys.argv[1:]:
        for name in HEADINGS:
            found = measure(name)
            text = json.dumps({**asdict(found), "accepted": found.accepted}, indent=2, allow_nan=False)
            (MEASUREMENTS / f"{name}.json").write_text(text + "\n", encoding="utf-8")
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), read()), encoding="utf-8")


if __name__ == "__main__":
    main()
