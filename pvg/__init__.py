"""Face colour transfer for portrait video: vectorise a clip once, then give it many looks.

    video = pvg.vectorize("clip.mp4")
    look = pvg.transfer(video, pvg.vectorize("portrait.jpg"), contrast=1.1)
    pvg.render(video, [look], ["out.mp4"])

The method is "PVG-Guided Face Color Transfer for Videos", IEEE Computer Graphics and Applications, 2021.
"""

from __future__ import annotations

__version__ = "0.1.0"

