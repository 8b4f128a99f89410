"""Renders scenes of the crop with Mitsuba 3 (BSD), one file for each mesh: the first step to a library of ``glbench.vision``.

    apt-get install libllvm19  # for Mitsuba's fast variant; --variant scalar_rgb does without
    python -m benchmarks.vision_render lettuce --work runs/vision
    python -m benchmarks.vision_render tomato --work runs/vision

Light is a sum: every mesh is rendered under an even sky and under the sun from two sides, and each light of the library is a mixture.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from glbench.vision import lettuce, tomato
from glbench.vision.mesh import Mesh, draws, joined, of_grids, smooth, tubes

for library in sorted(Path("/usr/lib/x86_64-linux-gnu").glob("libLLVM-19.so*"))[:1]:
    os.environ.setdefault("DRJIT_LIBLLVM_PATH", str(library))  # Mitsuba crashes with LLVM 15

SIZE, DEPTH = 96, 4
SAMPLES = (16, 8, 8)
"""Paths of a pixel under the sky and each sun."""
SUNS = ((58.0, 200.0), (26.0, 285.0))
"""Height above the horizon, and direction from the north [degrees]: noon in May, late afternoon."""
LIGHTS = (
    ((0.95, 1.00, 1.05), (0.00, 0.00, 0.00), (0.00, 0.00, 0.00)),  # overcast
    ((0.36, 0.42, 0.50), (1.00, 0.95, 0.86), (0.00, 0.00, 0.00)),  # noon: the glass scatters part of the sun
    ((0.34, 0.38, 0.44), (0.00, 0.00, 0.00), (1.00, 0.82, 0.60)),  # late afternoon
)
"""Red, green and blue of sky and suns in each light of the library."""
LEAF = {
    "type": "principledthin", "base_color": {"type": "mesh_attribute", "name": "vertex_color"},
    "diff_trans": 0.6, "roughness": 0.5, "spec_trans": 0.0, "eta": 1.35,
}  # fmt: skip
"""Leaves reflect more than they let through, and shine a little."""
GROUND = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}}
FRUIT = {
    "type": "twosided", "bsdf": {
        "type": "principled", "base_color": {"type": "mesh_attribute", "name": "vertex_color"}, "roughness": 0.25, "specular": 0.5,
    },
}  # fmt: skip
ABOVE = {"look": {"origin": [0, 0, 1.6], "target": [0, 0, 0], "up": [0, 1, 0]}, "fov": 21.5}
"""A camera 1.6 m above the bed, which sees 0.6 m of the ground across."""
BESIDE = {"look": {"origin": [0, -2.45, 1.46], "target": [0, 0, 1.46], "up": [0, 0, 1]}, "fov": 32.0}
"""A camera in front of a row, 2.45 m from its middle; it sees the front line of stems from 0.2 to 2.7 m."""
Parts = dict[str, tuple[Mesh, dict[str, Any]]]
VARIATIONS = 36
"""Plant variations of lettuce."""
OWN_ROWS, ROWS, STATES = 400, 8, 25
"""Of tomato: rows in one state each, for the encoder; other rows, each in so many states."""
PICKED = (1.0, 4.0, 10.0, 18.0)
"""Ripe fruits in these states [m-2]: just picked, and days later."""
STAGES = 40
"""Stages that a tomato passes from set to red."""
TALL = {"lettuce": 1, "tomato": 2}
"""Height of a picture over its width."""
MASSES = np.round(np.concatenate([np.geomspace(3, 130, 17)[:-1], np.geomspace(130, 700, 25)]), 1)
"""Mean fresh mass of the heads in a scene [g]: steps of 27 % below 130 g, of 7 % above."""


class Renderer:
    """Renders meshes, in one thread: the same mesh and seed give the same pixels."""

    def __init__(self, variant: str = "llvm_ad_rgb", size: int = SIZE, samples: tuple[int, ...] = SAMPLES, tall: int = 1) -> None:
        import drjit
        import mitsuba

        mitsuba.set_variant(variant)
        drjit.set_thread_count(1)
        self.mi, self.width, self.height, self.samples = mitsuba, size, size * tall, samples

    def parts(self, parts: dict[str, tuple[Mesh, dict[str, Any]]], view: dict[str, Any], seed: int) -> tuple[NDArray[np.float64], float]:
        """Radiance under the even sky and each sun, shape (3, height, width, 3), and the share of the picture that the first part takes."""
        mi = self.mi
        film = {"type": "hdrfilm", "width": self.width, "height": self.height, "pixel_format": "rgb", "rfilter": {"type": "box"}}
        camera = {"type": "perspective", "to_world": mi.ScalarTransform4f().look_at(**view["look"]), "film": film, "fov": view["fov"]}
        shapes = {name: self._shape(mesh, bsdf, name) for name, (mesh, bsdf) in parts.items()}
        lamps: dict[str, dict[str, Any]] = {"sky": {"type": "constant", "radiance": 1.0}}
        for number, (height, azimuth) in enumerate(np.radians(SUNS)):
            ray = [-np.cos(height) * np.sin(azimuth), -np.cos(height) * np.cos(azimuth), -np.sin(height)]
            lamps[f"sun{number}"] = {"type": "directional", "direction": ray, "irradiance": float(np.pi * 0.9 / np.sin(height) ** 0.5)}
        path = {"type": "path", "max_depth": DEPTH}
        scene = mi.load_dict({"type": "scene", "integrator": path, "camera": camera, **lamps, **shapes})
        settings = mi.traverse(scene)
        shine = {name: name + (".radiance.value" if name == "sky" else ".irradiance.value") for name in lamps}
        full = {name: float(np.ravel(np.array(settings[key]))[0]) for name, key in shine.items()}
        pictures = []
        for lamp, samples in zip(lamps, self.samples, strict=True):
            for name, key in shine.items():  # one lamp at a time, all others off
                settings[key] = full[name] * (name == lamp)
                settings[f"{name}.sampling_weight"] = float(name == lamp)
            settings.update()
            pictures.append(np.nan_to_num(np.array(mi.render(scene, spp=samples, seed=seed), dtype=np.float64)))
        return np.stack(pictures), self._share(scene, next(iter(parts)))

    def _shape(self, mesh: Mesh, bsdf: Any, name: str) -> Any:
        mi = self.mi
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(bsdf)
        shape = mi.Mesh(name, len(mesh.vertices), len(mesh.triangles), has_vertex_normals=True, props=properties)
        shape.add_attribute("vertex_color", 3, mesh.colours.astype(np.float32).ravel())
        parameters = mi.traverse(shape)
        parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
        parameters["faces"] = mesh.triangles.astype(np.uint32).ravel()
        parameters["vertex_normals"] = normals(mesh).astype(np.float32).ravel()
        parameters.update()
        return shape

    def _share(self, scene: Any, name: str) -> float:
        mi, camera = self.mi, scene.sensors()[0]
        wanted = next(shape for shape in scene.shapes() if shape.id() == name)
        columns, rows = ((np.arange(pixels) + 0.5) / pixels for pixels in (self.width, self.height))
        if mi.variant().startswith("scalar"):
            rays = (camera.sample_ray(0.0, 0.5, [x, y], [0.5, 0.5])[0] for y in rows for x in columns)
            return float(np.mean([scene.ray_intersect(ray).shape == wanted for ray in rays]))
        x, y = (axis.ravel().astype(np.float32) for axis in np.meshgrid(columns, rows))
        ray, _ = camera.sample_ray(0.0, 0.5, mi.Point2f(mi.Float(x), mi.Float(y)), mi.Point2f(0.5))
        return float(np.mean(np.array(scene.ray_intersect(ray).shape == mi.ShapePtr(wanted))))


def normals(mesh: Mesh) -> NDArray[np.float64]:
    """Unit normal of each vertex: the mean of its triangles, by area."""
    a, b, c = (mesh.vertices[mesh.triangles[:, corner]] for corner in range(3))
    face = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    total = np.stack([np.bincount(mesh.triangles.ravel(), face[:, axis], minlength=len(mesh.vertices)) for axis in range(3)], axis=-1)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


def developed(radiance: NDArray[np.float64]) -> NDArray[np.uint8]:
    """A picture of eight bits a channel (sRGB), exposed by its mean, with a soft shoulder."""
    grey = radiance @ [0.2126, 0.7152, 0.0722]
    exposed = radiance * (0.19 / max(float(np.minimum(grey, 3.0 * np.median(grey)).mean()), 1e-3))
    value = np.clip(exposed * (1.0 + 1.0 / 2.0) / (1.0 + exposed / 2.0), 0.0, 1.0)
    curve = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return (curve * 255.0 + 0.5).astype(np.uint8)


def under(light: int, pictures: NDArray[np.float64]) -> NDArray[np.uint8]:
    """The picture of a scene under a light of ``LIGHTS``, of its pictures under sky and suns."""
    return developed(np.einsum("kijc,kc->ijc", pictures, np.array(LIGHTS[light])))


def soil(variation: int) -> Mesh:
    """Crumbly ground."""
    own = draws(3, variation)
    side = np.linspace(-0.55, 0.55, 111)
    x, y = np.meshgrid(side, side, indexing="ij")
    noise = own.normal(size=x.shape)
    smoother = (noise + np.roll(noise, 1, 0) + np.roll(noise, 1, 1) + np.roll(noise, (1, 1), (0, 1))) / 2.0
    points = np.stack([x, y, 0.004 * smoother - 0.008], axis=-1)
    brown = np.array([0.105, 0.075, 0.052]) * (1.0 + 0.10 * own.normal())
    return of_grids(points[None], (brown * (1.0 + 0.20 * noise[..., None] + 0.15 * smoother[..., None]))[None])


def near(mesh: Mesh, reach: float) -> Mesh:
    """The triangles within ``reach`` [m] of the middle, in x and y."""
    kept = mesh.triangles[np.abs(mesh.vertices[mesh.triangles][..., :2]).max(axis=(1, 2)) < reach]
    used, triangles = np.unique(kept, return_inverse=True)
    return Mesh(mesh.vertices[used], triangles.reshape(-1, 3), mesh.colours[used])


def lettuce_scene(mass: float, variation: int) -> tuple[dict[str, tuple[Mesh, dict[str, Any]]], float]:
    """The parts of a scene, and the leaf area index of the bed."""
    leaves, heads = lettuce.bed(mass, variation)
    index = leaves.area / len(heads) * lettuce.PLANTS
    return {"leaves": (near(leaves, 0.40), LEAF), "soil": (soil(variation), GROUND)}, index


def plane(corner: Sequence[float], one: Sequence[float], other: Sequence[float], colour: Sequence[float]) -> Mesh:
    """A rectangle from a corner along two edges [m]."""
    points = np.array(corner) + np.array([[[0.0, 0.0, 0.0], other], [one, np.add(one, other)]])
    return of_grids(points[None], np.broadcast_to(np.array(colour), (1, 2, 2, 3)))


def moved(mesh: Mesh, by: Sequence[float]) -> Mesh:
    """The mesh somewhere else [m]."""
    return Mesh(mesh.vertices + np.array(by), mesh.triangles, mesh.colours)


def house(variation: int) -> Mesh:
    """What is around a row: white ground cover, gutter and slabs, rails of heating pipes."""
    own, reach = draws(6, variation), 2.5
    film, half = 0.62 * (1.0 + 0.08 * own.normal()), tomato.LINES / 2.0
    meshes = [plane((-reach, -3.0, 0.0), (2 * reach, 0.0, 0.0), (0.0, 6.5, 0.0), (film, film, film))]
    for middle in (0.0, tomato.PITCH):
        for line in (middle - half, middle + half):
            for low, high, width, grey in ((0.30, 0.36, 0.20, 0.75), (0.36, 0.45, 0.15, 0.68)):
                front = plane((-reach, line - width / 2, low), (2 * reach, 0.0, 0.0), (0.0, 0.0, high - low), (grey, grey, 0.98 * grey))
                top = plane((-reach, line - width / 2, high), (2 * reach, 0.0, 0.0), (0.0, width, 0.0), (grey, grey, grey))
                meshes += [front, moved(front, (0.0, width, 0.0)), top]
        rails = [[(-reach, middle + aside, 0.12), (reach, middle + aside, 0.12)] for aside in (-1.05, -0.55)]
        meshes.append(tubes(np.array(rails), 0.026, (0.7, 0.7, 0.7)))
    return joined(meshes)


def tomato_scene(leaf_area_index: float, fruits: NDArray[np.float64], variation: int) -> tuple[Parts, tomato.Row]:
    """The parts of a scene, and the row in front; the same plants stand behind it."""
    row = tomato.row(leaf_area_index, fruits, variation)
    parts: Parts = {}
    for name, mesh, bsdf in (("leaves", row.leaves, LEAF), ("fruit", row.fruit, FRUIT), ("stems", row.stems, GROUND)):
        parts[name] = (joined([mesh, moved(mesh, (0.17, tomato.PITCH, 0.0))]), bsdf)
    return parts | {"house": (house(variation), GROUND)}, row


def fruits_of(oldest: float, full: float, ripe: float) -> NDArray[np.float64]:
    """Fruits of a crop by stage [m-2]: ``full`` of them from set to ripe, of which those up to ``oldest`` are there, and ``ripe`` ones."""
    unripe = round(STAGES * tomato.RIPE)
    fruits = np.where(np.arange(STAGES) < round(unripe * oldest), full / unripe, 0.0)
    fruits[unripe:] = ripe / (STAGES - unripe)
    return fruits


@dataclass(frozen=True)
class Job:
    """A scene to render: the name of its file, the plant variation, what makes its parts and what is true of it, and its view."""

    name: str
    variation: int
    make: Callable[[], tuple[Parts, dict[str, Any]]]
    view: dict[str, Any]
    seed: int


def lettuce_jobs() -> list[Job]:
    """Each mass with each variation, the coarse grid first: half of it serves to try."""

    def make(mass: float, variation: int) -> tuple[Parts, dict[str, Any]]:
        parts, index = lettuce_scene(mass, variation)
        return parts, {"mass": mass, "leaf_area_index": index}

    rows = sorted(enumerate(MASSES), key=lambda entry: bin(entry[0])[:1:-1])
    return [
        Job(f"{row:02d}-{variation:02d}", variation, partial(make, float(mass), variation), ABOVE, 1000 * row + variation)
        for row, mass in rows
        for variation in range(VARIATIONS)
    ]


def tomato_states() -> list[tuple[int, float, NDArray[np.float64]]]:
    """Variation, leaf area index and fruits by stage of each scene.

    First rows of their own, for the encoder, spread evenly over what a crop can be; then ``ROWS`` rows that are shown, each in ``STATES``
    states of a season: leaves grow, fruits follow; from ripe trusses on, ripe fruits are few or many, and leaves become fewer.
    """
    states = []
    for number, (leaf, oldest, full, ripe) in enumerate(qmc.Halton(4, scramble=False).random(OWN_ROWS + 1)[1:]):
        ripe_fruits = 30.0 * ripe**1.5 if oldest > 2.0 / 3.0 else 0.0
        states.append((number, 0.3 + 4.2 * leaf**1.3, fruits_of(min(1.5 * oldest, 1.0), 40.0 + 120.0 * full, ripe_fruits)))
    for number, (leaf, full) in enumerate(qmc.Halton(2, scramble=False).random(ROWS + 1)[1:]):
        for place in range(STATES):
            moment = place / (STATES - 1)
            oldest = float(np.clip((moment - 0.12) / 0.45, 0.0, 1.0))
            ripe_fruits = PICKED[place % len(PICKED)] if oldest >= 1.0 else 0.0
            index = (0.35 + (1.9 + 1.8 * leaf) * float(smooth(moment, 0.0, 0.5))) * (1.0 - 0.3 * float(smooth(moment, 0.6, 1.0)))
            states.append((OWN_ROWS + number, index, fruits_of(oldest, 70.0 + 70.0 * full, ripe_fruits)))
    return states


def tomato_jobs() -> list[Job]:
    """The scenes of ``tomato_states``."""

    def make(index: float, fruits: NDArray[np.float64], variation: int) -> tuple[Parts, dict[str, Any]]:
        parts, row = tomato_scene(index, fruits, variation)
        numbers = {"fruits": tomato.STEMS * row.fruits.mean(), "ripe": tomato.STEMS * row.ripe.mean()}
        return parts, {"leaf_area_index": index, **numbers, "stems": np.stack([row.fruits, row.ripe])}

    return [
        Job(f"{number:03d}", variation, partial(make, index, fruits, variation), BESIDE, number)
        for number, (variation, index, fruits) in enumerate(tomato_states())
    ]


def main() -> None:
    """Render what is not there yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("crop", choices=["lettuce", "tomato"])
    parser.add_argument("--work", type=Path, required=True, help="folder for the rendered scenes")
    parser.add_argument("--variant", default="llvm_ad_rgb")
    options = parser.parse_args()
    renderer = Renderer(options.variant, tall=TALL[options.crop])
    folder = options.work / options.crop
    folder.mkdir(parents=True, exist_ok=True)
    began, number = time.process_time(), 0
    for job in {"lettuce": lettuce_jobs, "tomato": tomato_jobs}[options.crop]():
        file = folder / f"{job.name}.npz"
        if file.exists():
            continue
        parts, truth = job.make()
        pictures, cover = renderer.parts(parts, job.view, seed=job.seed)
        images = np.stack([under(light, pictures) for light in range(len(LIGHTS))])
        unfinished = file.with_suffix(".partial.npz")
        np.savez_compressed(unfinished, variation=job.variation, images=images, cover=cover, **truth)
        unfinished.replace(file)
        number += 1
        if number % 20 == 0:
            print(f"{number} scenes, {(time.process_time() - began) / number:.2f} s of processor time each", flush=True)


if __name__ == "__main__":
    main()
