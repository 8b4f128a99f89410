"""The shipped library, and what it says when something is wrong."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from docs import vision_table
from glbench import resources
from glbench.arrays import packed
from glbench.episodes.rerun_recording import RunSet, Trajectory
from glbench.episodes.signals import signals_of
from glbench.errors import GlbenchError
from glbench.resources import data_folder
from glbench.tasks import get_task
from glbench.vision import Encoder, Library
from glbench.vision.library import ROLES
from tests.house.test_resources import install_data, wheel  # noqa: F401


@pytest.fixture(scope="module")
def library() -> Library:
    return Library.open("lettuce")


def test_every_mass_variation_and_light_is_there(library: Library) -> None:
    masses, seeds, lights = np.unique(library.truth["mass"]), np.unique(library.seeds), np.unique(library.lights)
    scenes = set(zip(library.truth["mass"], library.seeds, library.lights, strict=True))
    assert len(scenes) == len(library.truth["mass"]) == len(masses) * len(seeds) * len(lights)
    assert np.array_equal(seeds, np.arange(len(seeds)))
    assert (masses[0], masses[-1]) == (3.0, 700.0)
    assert max(np.diff(np.log(masses[masses > 130.0]))) < 0.08
    assert np.abs(library.features).max() <= 1.0
    assert library.features.shape == (len(library.truth["mass"]), len(library.columns))


def test_pick_shows_the_nearest_mass_of_plants_that_the_encoder_has_not_seen(library: Library) -> None:
    grid = np.unique(library.truth["mass"])
    wanted = np.array([0.0, 3.1, 217.0, 345.0, 5000.0])
    middle = np.full(5, 0.5)
    picked = library.pick(wanted, middle, middle)
    assert library.truth["mass"][picked].tolist() == [float(grid[np.argmin(np.abs(grid - mass))]) for mass in wanted]
    rng = np.random.default_rng(1)
    many = library.pick(rng.uniform(3, 700, 2000), rng.random(2000), rng.random(2000))
    assert library.plants("training")[many].all()
    assert set(library.seeds[many]) == set(library.seeds[library.plants("training")])
    assert set(library.lights[many]) == set(library.lights)
    for role in ROLES:
        assert library.plants(role)[library.pick(wanted, middle, middle, role)].all()
    with pytest.raises(ValueError, match=r"light\[1\] is 1\.0: it must be at least 0, and below 1"):
        library.pick(wanted[:2], middle[:2], np.array([0.2, 1.0]))


def test_what_no_scene_shows_is_refused_in_words(library: Library) -> None:
    middle, tomato = np.array([0.5]), Library.open("tomato")
    assert library.pick([340.0], [0.5], [0.5]).tolist() == library.pick(np.array([340.0]), middle, middle).tolist()  # type: ignore[arg-type]
    for call, words in (
        (lambda: library.pick(np.array([np.nan]), middle, middle), r"mass\[0\] is nan: it must be at least 0, and finite"),
        (
            lambda: library.pick(np.array([340.0]), middle, middle, "validation"),
            "There are no plants for 'validation'.*validation shows those of tr",
        ),  # type: ignore[arg-type]
        (lambda: tomato.pick(np.array([340.0]), middle, middle), "Scenes of tomato have no mass. Use nearest, by leaf_area_index, fruits"),
        (
            lambda: tomato.nearest(np.array([[np.nan, 95.0, 6.0]]), 3),
            r"States must be finite, of shape \(n, 3\): leaf_area_index, fruits, ripe",
        ),
        (lambda: tomato.nearest(np.array([2.8, 95.0, 6.0]), 3), r"States must be finite, of shape \(n, 3\)"),
        (lambda: tomato.nearest(np.array([[2.8, 95.0, 6.0]]), 3, light=3), "a light is 0 to 2"),
        (lambda: Encoder((), (), ()).features(np.zeros((96, 96, 3), np.uint8)), r"Pictures must be uint8 of shape \(n, height, width, 3\)"),
        (lambda: Encoder((), (), ()).features(np.zeros((1, 9, 9, 3))), "not float64 of shape"),  # type: ignore[arg-type]
    ):
        with pytest.raises(ValueError, match=words):
            call()
    for index in (-1, len(library.seeds)):
        with pytest.raises(GlbenchError, match=f"There is no scene {index}: scenes are numbered 0 to 4427"):
            library.image(index)


def test_the_features_are_those_of_the_pictures(library: Library) -> None:
    pytest.importorskip("PIL")
    encoder = Encoder.at(data_folder("images") / "lettuce-2.encoder.npz")
    scenes = library.pick(np.array([20.0, 150.0, 350.0]), np.array([0.1, 0.4, 0.9]), np.array([0.1, 0.5, 0.9]))
    pictures = np.stack([library.image(int(scene)) for scene in scenes])
    assert pictures.shape == (3, 96, 96, 3)
    features = encoder.features(pictures)
    assert features == pytest.approx(library.features[scenes], abs=0.02), "decoders may differ in the last bit of a pixel"
    assert encoder.estimates(library.features) == pytest.approx(library.estimates, rel=1e-4)


def test_heavy_heads_are_told_from_light_ones(library: Library) -> None:
    shown = ~library.plants("encoder") & (library.truth["mass"] >= 100.0)
    assert vision_table.rms(vision_table.errors(library, shown)) < 0.15
    assert vision_table.determination(library, shown) > 0.9


def test_the_manifest_knows_the_files() -> None:
    folder = data_folder("images")
    manifest = tomllib.loads((folder / "manifest.toml").read_text(encoding="utf-8"))
    entry = manifest["lettuce-2"]
    assert Library.open("lettuce").digest == entry["sha256"]
    assert resources.hashlib.sha256((folder / "lettuce-2.encoder.npz").read_bytes()).hexdigest() == entry["encoder_sha256"]
    assert max(file.stat().st_size for file in folder.iterdir()) < 20e6
    with pytest.raises(GlbenchError, match=r"no pictures 'cucumber'. There are: lettuce-2, tomato-1"):
        Library.open("cucumber")
    with pytest.raises(GlbenchError, match="no pictures 'lettuce-1'"):
        Library.open("lettuce", "1")


def test_a_damaged_library_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "x.npz"
    with pytest.raises(GlbenchError, match="Cannot read the pictures"):
        Library.at(file)
    file.write_bytes(packed(format=2, crop="lettuce"))
    with pytest.raises(GlbenchError, match="it has no 'mass'"):
        Library.at(file)
    file.write_bytes(packed(format=2, crop="rose"))
    with pytest.raises(GlbenchError, match=r"its crop is 'rose', not one of lettuce, tomato\.$"):
        Library.at(file)
    with pytest.raises(GlbenchError, match=r"the manifest says abc. Install glbench-data again"):
        Library.at(file, "abc")


def test_a_wheel_alone_says_what_to_install(wheel: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    with pytest.raises(GlbenchError, match=r"pip install glbench-data==7\.8\.9"):
        Library.open("lettuce")
    package = install_data(wheel, "ab" * 32, monkeypatch)
    (package / "images").symlink_to(Path(__file__).resolve().parents[2] / "glbench-data" / "images")
    resources._data_package.cache_clear()
    assert Library.open("lettuce").crop == "lettuce"


def test_the_page_holds_what_the_library_says(library: Library) -> None:
    page = vision_table.PAGE.read_text(encoding="utf-8")
    assert vision_table.filled(page, library, Library.open("tomato")) == page


def test_the_nearest_state_of_one_row_is_shown() -> None:
    tomato = Library.open("tomato")
    mine = np.flatnonzero(
        tomato.plants("test") & (tomato.lights == 1) & (tomato.seeds == np.unique(tomato.seeds[tomato.plants("test")])[3])
    )
    states = np.stack([values[mine] for values in tomato.truth.values()], axis=-1)
    assert states.shape == (25, 3)
    assert np.array_equal(tomato.nearest(states, 3), mine)
    assert np.array_equal(tomato.nearest(states + 1e-3, 11), mine), "there are eight rows"
    far = tomato.nearest(np.array([[9.0, 900.0, 90.0], [0.0, 0.0, 0.0]]), 3)
    assert tomato.truth["leaf_area_index"][far[0]] > 2.0
    assert tomato.truth["fruits"][far[1]] == 0.0
    assert tomato.image(int(far[0])).shape == (192, 96, 3)


def test_ripe_fruit_is_seen_in_rows_that_the_encoder_has_not_seen() -> None:
    tomato = Library.open("tomato")
    rows, place = tomato.plants("test"), 2
    off, true = tomato.estimates[rows, place] - tomato.truth["ripe"][rows], tomato.truth["ripe"][rows]
    assert 1.0 - np.mean(off**2) / np.var(true) > 0.75


@pytest.mark.parametrize(("name", "flowers"), [("GreenhouseReal-v1", 28 * 2.219e-6 / 1.44542e-5), ("SpringTrusses-v1", 1.0)])
def test_the_viewer_shows_the_row_of_noon(name: str, flowers: float) -> None:
    """A fruit of cherry tomatoes, whose stems have more flowers, is a share of one of the round tomatoes that are drawn."""
    task, hours = get_task(f"glbench/{name}"), np.tile(np.arange(24.0), 3)
    signals = signals_of(task)
    columns = {name: np.zeros(72) for name in (*signals.needed, signals.clock, "cLeaf", "fruits", "nRipe")}
    columns |= {signals.clock: hours, "cLeaf": np.linspace(2e4, 1.3e5, 72), "fruits": np.linspace(0.0, 90.0, 72), "nRipe": np.zeros(72)}
    times = np.datetime64("2010-03-01T00", "ns") + np.arange(73) * np.timedelta64(1, "h")

    def pictures(**changes: np.ndarray) -> tuple[Library, np.ndarray] | None:
        trajectory = Trajectory("a", 10_003, times, columns | changes)
        return RunSet(task, (trajectory,), ("a",), signals).pictures(trajectory)

    made = pictures()
    assert made is not None
    library, scenes = made
    assert np.flatnonzero(np.diff(scenes)).tolist() == [11, 35, 59], "a new picture at each noon"
    states = np.stack([2.66e-5 * columns["cLeaf"], columns["fruits"] / flowers, columns["nRipe"]], axis=-1)
    assert np.array_equal(scenes[[0, 12, 36, 60]], library.nearest(states[[0, 12, 36, 60]], 10_003))
    assert len(np.unique(library.seeds[scenes])) == 1, "the same plants all the time"
    del columns["nRipe"]
    assert pictures() is None
