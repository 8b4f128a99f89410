"""Trains the encoder on some plants, and packs all rendered scenes with what it makes of them: the second step to a library.

python -m benchmarks.vision_library lettuce --work runs/vision            # or tomato; needs PyTorch and pillow
python -m benchmarks.vision_library lettuce --work runs/vision --try 3    # three of the training plants are held out; nothing is written
"""

from __future__ import annotations

import argparse
import hashlib
import io
import re
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import packed
from glbench.resources import data_folder, write_atomically
from glbench.vision.encoder import Encoder
from glbench.vision.library import ROLES, TRUTH, Role

SHOWN: dict[str, dict[Role, int]] = {"lettuce": {"training": 8, "test": 8}, "tomato": {"test": 8}}
"""Number of plant variations for training and for tests, which the encoder is not trained on: the last ones, those of tests at the end."""
VERSIONS = {"lettuce": "2", "tomato": "1"}
ESTIMATED = {"lettuce": {"mass": 1.0, "cover": 0.05}, "tomato": {"leaf_area_index": 1.0, "fruits": 1.0, "ripe": 1.0}}
"""What the encoder is trained to estimate, the first by its logarithm, and the weight of the error of each."""
FEATURES, CHANNELS, HIDDEN = 6, (16, 32, 48, 64), 48
EPOCHS, BATCH, RATE = 60, 64, 3e-3
QUALITY = 80


class Scenes:
    """All rendered scenes of a crop, as they will be stored: after packing."""

    def __init__(self, crop: str, folder: Path) -> None:
        from PIL import Image

        files = [np.load(file) for file in sorted(folder.glob("*.npz")) if not file.name.endswith(".partial.npz")]
        lights = len(files[0]["images"])
        self.truth = {name: np.repeat([float(file[name]) for file in files], lights) for name in TRUTH[crop]}
        self.seeds = np.repeat([int(file["variation"]) for file in files], lights).astype(np.int64)
        self.lights = np.tile(np.arange(lights), len(files))
        self.packed = []
        for picture in np.concatenate([file["images"] for file in files]):
            file = io.BytesIO()
            Image.fromarray(picture).save(file, "WEBP", quality=QUALITY, method=6)
            self.packed.append(file.getvalue())
        self.pictures = np.stack([np.asarray(Image.open(io.BytesIO(content)).convert("RGB")) for content in self.packed])


def train(crop: str, pictures: NDArray[np.uint8], truth: dict[str, NDArray[np.float64]], epochs: int) -> Encoder:
    """Train on pictures with known truth; mirrored, turned (lettuce) or moved along the row, of varied brightness, contrast and colour."""
    import torch
    from torch import nn

    torch.manual_seed(0)
    torch.set_num_threads(1)
    widths = (3, *CHANNELS)
    convolutions = nn.ModuleList(nn.Conv2d(a, b, 3, stride=2, padding=1) for a, b in pairwise(widths))
    norms = nn.ModuleList(nn.BatchNorm2d(b) for b in CHANNELS)
    dense = nn.ModuleList([nn.Linear(CHANNELS[-1], HIDDEN), nn.Linear(HIDDEN, FEATURES), nn.Linear(FEATURES, len(ESTIMATED[crop]))])
    parts = nn.ModuleList([convolutions, norms, dense])

    def output(signal: Any) -> Any:
        for convolution, norm in zip(convolutions, norms, strict=True):
            signal = torch.relu(norm(convolution(signal)))
        return dense[2](torch.tanh(dense[1](torch.relu(dense[0](signal.mean(dim=(2, 3)))))))

    x = torch.from_numpy(pictures).permute(0, 3, 1, 2).float() / 255 - 0.5
    logarithm, *others = (truth[name] for name in ESTIMATED[crop])
    wanted = torch.from_numpy(np.stack([np.log(logarithm), *others], axis=-1)).float()
    weights = torch.tensor([*ESTIMATED[crop].values()])
    middle, spread = wanted.mean(dim=0), wanted.std(dim=0)
    wanted = (wanted - middle) / spread
    steps = epochs * -(-len(x) // BATCH)
    optimiser = torch.optim.AdamW(parts.parameters(), lr=RATE, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=steps)
    for epoch in range(epochs):
        total = 0.0
        for rows in torch.randperm(len(x)).split(BATCH):
            batch = x[rows]
            if crop == "lettuce":
                batch = torch.rot90(batch, int(torch.randint(4, ())), (2, 3))
            else:
                batch = torch.roll(batch, int(torch.randint(x.shape[3], ())), 3)
            batch = batch.flip(3) if torch.rand(()) < 0.5 else batch
            gain = 1.0 + 0.15 * torch.randn(len(rows), 1, 1, 1) + 0.08 * torch.randn(len(rows), 3, 1, 1)
            batch = batch * gain + 0.06 * torch.randn(len(rows), 1, 1, 1) + 0.03 * torch.randn(len(rows), 3, 1, 1)
            loss = ((output(batch) - wanted[rows]) ** 2 @ weights).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            total += float(loss.detach()) * len(rows) / len(x)
        if epoch % 10 == 9:
            print(f"epoch {epoch + 1}: loss {total:.5f}", flush=True)
    kernels, biases = [], []
    for convolution, norm in zip(convolutions, norms, strict=True):  # the norm becomes part of the convolution
        scale = (norm.weight / torch.sqrt(norm.running_var + norm.eps)).detach()
        kernels.append((convolution.weight.detach() * scale[:, None, None, None]).numpy())
        biases.append(((convolution.bias.detach() - norm.running_mean) * scale + norm.bias.detach()).numpy())
    layers = [np.concatenate([layer.weight.detach().numpy(), layer.bias.detach().numpy()[:, None]], axis=1) for layer in dense]
    layers[2] = layers[2] * spread.numpy()[:, None]
    layers[2][:, -1] += middle.numpy()
    return Encoder(tuple(kernels), tuple(biases), tuple(layers))


def applied(encoder: Encoder, pictures: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Features of many pictures."""
    return np.concatenate([encoder.features(some) for some in np.array_split(pictures, -(-len(pictures) // 32))])


def write(crop: str, scenes: Scenes, encoder: Encoder, roles: NDArray[np.int64]) -> None:
    """Write library, encoder and their entries in the manifest."""
    features = applied(encoder, scenes.pictures)
    content = packed(
        format=2, crop=crop, columns=tuple(f"camera_{number + 1}" for number in range(features.shape[1])), features=features,
        seeds=scenes.seeds, lights=scenes.lights.astype(np.int64), shown=roles, estimates=encoder.estimates(features), **scenes.truth,
        pictures=np.frombuffer(b"".join(scenes.packed), np.uint8),
        starts=np.cumsum([0, *(len(one) for one in scenes.packed)]).astype(np.int64),
    )  # fmt: skip
    folder = data_folder("images")
    write_atomically(folder / f"{crop}-{VERSIONS[crop]}.npz", content)
    write_atomically(folder / f"{crop}-{VERSIONS[crop]}.encoder.npz", encoder.file())
    manifest = folder / "manifest.toml"
    before = manifest.read_text(encoding="utf-8") if manifest.exists() else "# Libraries of rendered pictures; docs/vision.md.\n"
    others = re.sub(rf"\n\[{crop}-{VERSIONS[crop]}\]\n[^\[]*", "\n", before).rstrip("\n")
    entry = {
        "sha256": hashlib.sha256(content).hexdigest(),
        "encoder_sha256": hashlib.sha256(encoder.file()).hexdigest(),
        "made_by": f"python -m benchmarks.vision_render {crop}; python -m benchmarks.vision_library {crop}",
        "made_with": ", ".join(f"{name} {version(name)}" for name in ("mitsuba", "drjit", "torch", "numpy", "pillow")),
        "licence": "BSD-3-Clause, as glbench: rendered from its own shapes; Mitsuba (BSD-3-Clause) puts no terms on pictures",
        "contents": f"{len(scenes.seeds)} pictures of {scenes.pictures.shape[2]} by {scenes.pictures.shape[1]} pixels, WebP",
    }
    lines = "\n".join(f'{key} = "{value}"' for key, value in entry.items())
    write_atomically(manifest, f"{others}\n\n[{crop}-{VERSIONS[crop]}]\n{lines}\n")


def main() -> None:
    """Train, then write; or train on fewer plants and say how well it does on the rest."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("crop", choices=[*VERSIONS])
    parser.add_argument("--work", type=Path, required=True, help="folder of benchmarks.vision_render")
    parser.add_argument("--epochs", type=int, default=EPOCHS)
    parser.add_argument("--try", dest="held_out", type=int, default=0, help="number of training plants to hold out; writes nothing")
    options = parser.parse_args()
    crop, shown = options.crop, SHOWN[options.crop]
    scenes = Scenes(crop, options.work / crop)
    counts = [len(np.unique(scenes.seeds)) - sum(shown.values()), *shown.values()]
    roles = np.repeat([ROLES.index("encoder"), *(ROLES.index(name) for name in shown)], counts)[scenes.seeds]
    trained = roles == ROLES.index("encoder")
    used = trained & (scenes.seeds < counts[0] - options.held_out)
    print(f"{len(trained)} scenes, {used.sum()} to train on; {sum(map(len, scenes.packed)) / 1e6:.2f} MB of pictures", flush=True)
    encoder = train(crop, scenes.pictures[used], {name: values[used] for name, values in scenes.truth.items()}, options.epochs)
    if not options.held_out:
        write(crop, scenes, encoder, roles)
    for name, rows in (("trained on", used), ("held out", trained & ~used)):
        if rows.any():
            estimates = encoder.estimates(applied(encoder, scenes.pictures[rows]))
            for what, values in zip(ESTIMATED[crop], estimates.T, strict=True):
                off, truth = values - scenes.truth[what][rows], scenes.truth[what][rows]
                print(f"{name}, {what}: error {np.sqrt(np.mean(off**2)):.3g}, R2 {1.0 - np.mean(off**2) / np.var(truth):.3f}")


if __name__ == "__main__":
    main()
