"""The search of the sandbox finds number series in every form in which they could lie about, and nothing where there is none."""

from __future__ import annotations

import gzip
import io
import json
import pickle
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from glbench.weather import load_weather
from tests.evaluation.sandbox.content_search import Needles, Search

COUNTS = load_weather("greensboro").counts
TEMPERATURE = COUNTS["air_temperature"][2000:2480] / 1000.0
HUMIDITY = COUNTS["relative_humidity"][2000:2480] / 1000.0
RADIATION = COUNTS["global_radiation"][2000:2480] / 3600.0
PLAN = np.random.default_rng(5).integers(0, 2001, 500).astype(np.uint16)
DIGEST = "5d" * 32


@pytest.fixture(scope="module")
def needles() -> Needles:
    series = [(name, counts, 24) for name, counts in COUNTS.items()]
    return Needles.collect([*series, ("plan", PLAN, 48)], [DIGEST], [(10000, 100)])


def columns() -> str:
    rows = zip(TEMPERATURE, HUMIDITY, RADIATION, strict=True)
    return "".join(f"2010-03-{1 + i // 24:02} {i % 24:02}:00,{t:.1f},{h:.0f},{r:.0f}\n" for i, (t, h, r) in enumerate(rows))


def fixed() -> str:
    rows = zip(TEMPERATURE, HUMIDITY, strict=True)
    return "".join(f"20100301{i % 24:02}{round(10 * t):4d}A7{round(h):03d}E8\n" for i, (t, h) in enumerate(rows))


def packed(save: Callable[[io.BytesIO], object]) -> bytes:
    buffer = io.BytesIO()
    save(buffer)
    return buffer.getvalue()


def archive(content: bytes) -> bytes:
    def save(buffer: io.BytesIO) -> None:
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
            file.writestr("deep/data.bin", content)

    return packed(save)


def tape(content: bytes) -> bytes:
    def save(buffer: io.BytesIO) -> None:
        with tarfile.open(fileobj=buffer, mode="w") as file:
            member = tarfile.TarInfo("data.bin")
            member.size = len(content)
            file.addfile(member, io.BytesIO(content))

    return packed(save)


def noise(size: int) -> bytes:
    return b"\0" + np.random.default_rng(2).bytes(size)


RAW = TEMPERATURE.astype("<f4").tobytes()
FRAME = pd.DataFrame({"t": TEMPERATURE + 273.15, "name": "x"})
FORMS = {
    "columns": columns().encode(),
    "a table between other text": b"# nothing\n" * 900 + columns().encode() + b"and more text\n" * 500,
    "columns of fixed width": fixed().encode(),
    "other units": "".join(f"{i};{1.8 * t + 32:.2f}\n" for i, t in enumerate(TEMPERATURE)).encode(),
    "lines of Python": ("X = [\n" + "".join(f"    {t:.1f},\n" for t in TEMPERATURE) + "]\n").encode(),
    "JSON": json.dumps({"hours": [{"t": float(t), "h": float(h)} for t, h in zip(TEMPERATURE, HUMIDITY, strict=True)]}, indent=2).encode(),
    "float32": b"?" * 77 + RAW,
    "float64": b"?" * 5 + TEMPERATURE.tobytes() + b"!" * 9,
    "int16": (10 * TEMPERATURE).round().astype("<i2").tobytes(),
    "int64": b"\0" + COUNTS["air_temperature"][:200].tobytes(),
    "two megabytes into a file": noise(2_000_003) + RAW + noise(90_000),
    "int32": COUNTS["air_temperature"][:200].astype("<i4").tobytes(),
    "pickle": pickle.dumps({"weather": TEMPERATURE}),
    "npy": packed(lambda file: np.save(file, np.column_stack([TEMPERATURE, HUMIDITY]))),
    "npz": packed(lambda file: np.savez_compressed(file, t=TEMPERATURE)),
    "plans on another scale": packed(lambda file: np.savez(file, actions=(PLAN / 1000.0 - 1.0).astype(np.float32).reshape(1, 1, -1))),
    "Parquet": packed(lambda file: FRAME.to_parquet(file)),
    "Feather": packed(lambda file: FRAME.to_feather(file, compression="uncompressed")),
    "gzip": gzip.compress(columns().encode()),
    "zip": archive(RAW),
    "zip in tar in gzip": gzip.compress(tape(archive(columns().encode()))),
    "a digest": b'{"results_digest": "' + DIGEST.encode() + b'"}' + b" " * 40,
    "a digest between hexadecimal digits": b"\0" * 40 + b"abc" + DIGEST.encode() + b"0" * 99,
    "seeds in text": b'{"runs": [{"seed": 10000, "status": "ok"}, {"seed": 10001, "status": "ok"}]}',
    "seeds in an array": packed(lambda file: np.savez_compressed(file, seeds=np.arange(10000, 10100))),
}  # fmt: skip


@pytest.mark.parametrize("content", FORMS.values(), ids=FORMS)
def test_it_is_found_in_every_form(needles: Needles, tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "a" / "b" / "harmless.py").write_bytes(content)
    search = Search(needles)
    search.folder(tmp_path)

    assert search.found


def test_nothing_is_found_where_there_is_nothing(needles: Needles, tmp_path: Path) -> None:
    noise = np.random.default_rng(1)
    (tmp_path / "walk.csv").write_text("\n".join(f"{x:.1f},{y}" for x, y in np.cumsum(noise.normal(size=(9000, 2)), axis=0)))
    (tmp_path / "bytes").write_bytes(noise.bytes(300_000))
    (tmp_path / "sines").write_bytes(np.sin(np.arange(9000) * np.pi / 12.0).tobytes())
    (tmp_path / "characters").write_bytes(np.arange(9000, 12000, dtype="<u4").tobytes())
    search = Search(needles)
    search.folder(tmp_path)

    assert (search.found, search.looked["searched"]) == (set(), 4)


def test_needles_are_saved(needles: Needles, tmp_path: Path) -> None:
    needles.save(tmp_path / "needles.npz")
    read = Needles.load(tmp_path / "needles.npz")

    assert np.array_equal(read.windows, needles.windows)
    assert (read.names, read.digests, read.seeds) == (needles.names, needles.digests, needles.seeds)
