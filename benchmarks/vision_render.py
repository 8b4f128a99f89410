"""Renders scenes of the crop with Mitsuba 3 (BSD), one file for each mesh: the first step to a library of ``glbench.vision``.

    apt-get install libllvm19  # for Mitsuba's fast variant; --variant scalar_rgb does without
    python -m benchmarks.vision_render lettuce --work runs/vision

Light is a sum: every mesh is rendered under an even sky and under the sun from two sides, and each light of the library is a mixture.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.vision import lettuce
from glbench.vision.mesh import Mesh, draws, of_grids

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
ABOVE = {"look": {"origin": [0, 0, 1.6], "target": [0, 0, 0], "up": [0, 1, 0]}, "fov": 21.5}
"""A camera 1.6 m above the bed, which sees 0.6 m of the ground across."""
MASSES = np.round(np.concatenate([np.geomspace(3, 130, 17)[:-1], np.geomspace(130, 700, 25)]), 1)
"""Mean fresh mass of the heads in a scene [g]: steps of 27 % below 130 g, of 7 % above."""


class Renderer:
    """Renders meshes, in one thread: the same mesh and seed give the same pixels."""

    def __init__(self, variant: str = "llvm_ad_rgb", size: int = SIZE, samples: tuple[int, ...] = SAMPLES) -> None:
        import drjit
        import mitsuba

        mitsuba.set_variant(variant)
        drjit.set_thread_count(1)
        self.mi, self.size, self.samples = mitsuba, size, samples

    def parts(self, parts: dict[str, tuple[Mesh, dict[str, Any]]], view: dict[str, Any], seed: int) -> tuple[NDArray[np.float64], float]:
        """Radiance under the even sky and each sun, shape (3, size, size, 3), and the share of the picture that the first part takes."""
        mi = self.mi
        film = {"type": "hdrfilm", "width": self.size, "height": self.size, "pixel_format": "rgb", "rfilter": {"type": "box"}}
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
        grid = (np.arange(self.size) + 0.5) / self.size
        if mi.variant().startswith("scalar"):
            rays = (camera.sample_ray(0.0, 0.5, [x, y], [0.5, 0.5])[0] for y in grid for x in grid)
            return float(np.mean([scene.ray_intersect(ray).shape == wanted for ray in rays]))
        x, y = (axis.ravel().astype(np.float32) for axis in np.meshgrid(grid, grid))
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


def main() -> None:
    """Render what is not there yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("crop", choices=["lettuce"])
    parser.add_argument("--work", type=Path, required=True, help="folder for the rendered scenes")
    parser.add_argument("--variations", type=int, nargs=2, default=(0, 36), help="first one, and the first one left out")
    parser.add_argument("--variant", default="llvm_ad_rgb")
    options = parser.parse_args()
    renderer = Renderer(options.variant)
    folder = options.work / options.crop
    folder.mkdir(parents=True, exist_ok=True)
    began, number = time.process_time(), 0
    for row, mass in sorted(enumerate(MASSES), key=lambda entry: bin(entry[0])[:1:-1]):  # coarse first: half of it serves to try
        for variation in range(*options.variations):
            file = folder / f"{row:02d}-{variation:02d}.npz"
            if file.exists():
                continue
            parts, index = lettuce_scene(float(mass), variation)
            pictures, cover = renderer.parts(parts, ABOVE, seed=1000 * row + variation)
            images = np.stack([under(light, pictures) for light in range(len(LIGHTS))])
            partial = file.with_suffix(".partial.npz")
            np.savez_compressed(partial, mass=mass, variation=variation, images=images, cover=cover, leaf_area_index=index)
            partial.replace(file)
            number += 1
            if number % 20 == 0:
                print(f"{number} meshes, {(time.process_time() - began) / number:.2f} s of processor time each", flush=True)


if __name__ == "__main__":
    main()
