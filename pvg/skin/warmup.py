"""Every compiled kernel of the skin run once."""

from __future__ import annotations

import numpy as np

from pvg.face import Landmarks
from pvg.picture import Picture
from pvg.skin.body import BodyTracker
from pvg.skin.hair import Hair, hair_cover
from pvg.skin.learning import fit_skin_model
from pvg.skin.matte import Matte
from pvg.skin.prior import spatial_prior
from pvg.skin.scene import Scene, scene_raster
from pvg.skin.tracking import SkinTracker


def warm_up(picture: Picture, landmarks: Landmarks) -> Matte:
    """Follow a person's skin through one picture, and look for hair whether the picture has any or not."""
    height, width = picture.size
    prior = spatial_prior((height, width), landmarks)
    for fair in (True, False):
        hair = Hair(fair, np.zeros(3, np.float32), np.eye(3, dtype=np.float32))
        hair_cover(np.zeros((height, width, 3), np.uint8), prior.face, prior, hair)
    model = fit_skin_model(picture, landmarks)
    skin = SkinTracker(model)
    matte = skin.step(picture, landmarks)
    if model.learned is not None:
        raster = scene_raster(picture.size)
        nobody = np.zeros(raster.shape, np.uint8)
        black = np.zeros((*raster.shape, 3), np.uint8)
        scene = Scene(raster, black, nobody, None, (), changed=False, haze=0, contrast=0.0)
        BodyTracker(model.learned).step(scene, landmarks, matte, skin.light)
    return matte
