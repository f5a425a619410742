from __future__ import annotations

import cv2
import numpy as np

import pvg
from pvg.curves import place, table_labels


def test_boundary_colours_are_those_of_the_skin(video: pvg.VectorVideo) -> None:
    """g on the cheeks is near the picture's own colour there; lips are redder than skin."""
    key = video.records[0].key_frames[0]
    image = pvg.render_frame(video, None, key.frame).astype(np.float32)
    data = video.face_at(0, key.frame)
    assert data is not None
    smooth = cv2.GaussianBlur(image, (0, 0), 3)
    labels = table_labels()
    cheek = labels.on_curves("cheek_left", "cheek_right")
    cheek_places = np.rint(place(labels, data.landmarks, data.boundary)[cheek]).astype(int)
    seen = smooth[cheek_places[:, 1], cheek_places[:, 0]]
    assert np.abs(key.colors[cheek] - seen).mean() < 6.0
    lips = key.colors[labels.on_group("lips")].mean(axis=0)
    skin = key.colors[cheek].mean(axis=0)
    assert lips[0] - lips[1] > skin[0] - skin[1]
