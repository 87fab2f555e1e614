"""A folder of images as a source."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stringcast.data.images import ImageFiles
from stringcast.data.schema import DataError
from stringcast.hardware.camera.played import Played

ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


@dataclass(frozen=True)
class ImageFolder(Played):
    """folder: of image files, in the order of their names."""

    folder: Path

    @property
    def name(self) -> str:
        """The folder's path."""
        return f"images in {self.folder}"

    def images(self) -> Sequence[np.ndarray]:
        """The images of the folder."""
        files = sorted(p.name for p in self.folder.glob("*") if p.suffix.lower() in ENDINGS)
        if not files:
            raise DataError(
                f"{self.folder}: there is no image here ({', '.join(ENDINGS)}). Name the folder that has them."
            )
        return ImageFiles(self.folder, tuple(files))
