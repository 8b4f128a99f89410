"""The network that makes a few numbers of a picture: convolutions, in NumPy. Trained by benchmarks/vision_library.py, then frozen."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from glbench.arrays import ArrayFile, Floats, packed
from glbench.errors import refuse

Float32s = NDArray[np.float32]
_FORMAT = 1


@dataclass(frozen=True, eq=False)
class Encoder:
    """Convolutions of 3 by 3 pixels, each of which halves the picture; the mean over it; two layers, the last of them the features."""

    kernels: tuple[Float32s, ...]
    """Of each convolution, shape (out, in, 3, 3)."""
    biases: tuple[Float32s, ...]
    """Of each convolution, shape (out,)."""
    dense: tuple[Float32s, ...]
    """Weights of the layer after the mean, of the features and of the estimates, shape (out, in + 1): the last column is the bias."""

    @classmethod
    def at(cls, file: Path) -> Encoder:
        """The encoder in ``file``. Raises ``OSError``, ``ValueError`` when it cannot be read or is none; messages go on after "it"."""
        arrays = ArrayFile.at(file)
        arrays.check_format(_FORMAT)
        layers = range(arrays.count("kernel"))
        return cls(
            tuple(arrays.floats(f"kernel{layer}", 4, np.float32) for layer in layers),
            tuple(arrays.floats(f"bias{layer}", 1, np.float32) for layer in layers),
            tuple(arrays.floats(f"dense{layer}", 2, np.float32) for layer in range(arrays.count("dense"))),
        )

    def file(self) -> bytes:
        """The bytes of its file."""
        named = {"kernel": self.kernels, "bias": self.biases, "dense": self.dense}
        return packed(format=_FORMAT, **{f"{name}{layer}": array for name, arrays in named.items() for layer, array in enumerate(arrays)})

    def features(self, pictures: NDArray[np.uint8]) -> Floats:
        """Features of pictures of shape (n, height, width, 3): numbers from -1 to 1, shape (n, features). ``ValueError`` for others."""
        if pictures.ndim != 4 or pictures.shape[3] != 3 or pictures.dtype != np.uint8:
            refuse(f"Pictures must be uint8 of shape (n, height, width, 3), not {pictures.dtype} of shape {pictures.shape}.")
        signal = pictures.astype(np.float32) / 255 - 0.5
        for kernel, bias in zip(self.kernels, self.biases, strict=True):
            framed = np.pad(signal, ((0, 0), (1, 1), (1, 1), (0, 0)))
            windows = sliding_window_view(framed, (3, 3), axis=(1, 2))[:, ::2, ::2]  # (n, rows, columns, in, 3, 3)
            signal = np.maximum(np.tensordot(windows, kernel, axes=((3, 4, 5), (1, 2, 3))) + bias, 0)
        hidden = np.maximum(_layer(self.dense[0], signal.mean(axis=(1, 2))), 0)
        return np.asarray(np.tanh(_layer(self.dense[1], hidden)), dtype=np.float64)

    def estimates(self, features: Floats) -> Floats:
        """What the scenes that have these features show, shape (n, estimates): mass [g] and cover of lettuce, see ``Library.estimates``."""
        logarithm, *others = _layer(self.dense[2], features).T
        return np.stack([np.exp(logarithm), *others], axis=-1)


def _layer(weights: Float32s, signal: NDArray[np.floating]) -> NDArray[np.floating]:
    return np.asarray(signal @ weights[:, :-1].T + weights[:, -1])
