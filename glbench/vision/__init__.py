"""Pictures of the crop: plants as triangles, a library of rendered scenes, and the encoder that makes a few numbers of each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glbench.extras import lazy_names

if TYPE_CHECKING:
    from glbench.vision.encoder import Encoder
    from glbench.vision.library import Library
else:
    __getattr__ = lazy_names(__name__)

__all__ = ["Encoder", "Library"]
