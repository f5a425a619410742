"""Skin masks and soft mattes: one picture guided by its landmarks, or a face through a clip (docs/skin.md)."""

from __future__ import annotations

from pvg.skin.body import BodyTracker
from pvg.skin.body_consensus import BodyConsensus, BodyInTime
from pvg.skin.consensus import MatteConsensus, MatteInTime
from pvg.skin.learning import fit_skin_model
from pvg.skin.matte import Matte
from pvg.skin.network import NetworkOutput
from pvg.skin.prior import face_box
from pvg.skin.scene import Scene, SceneReader, haze_over, person_mask, scene_raster
from pvg.skin.segmentation import MaskMethod, skin_mask
from pvg.skin.tracking import SkinTracker
from pvg.skin.warmup import warm_up

__all__ = [
    "BodyConsensus",
    "BodyInTime",
    "BodyTracker",
    "MaskMethod",
    "Matte",
    "MatteConsensus",
    "MatteInTime",
    "NetworkOutput",
    "Scene",
    "SceneReader",
    "SkinTracker",
    "face_box",
    "fit_skin_model",
    "haze_over",
    "person_mask",
    "scene_raster",
    "skin_mask",
    "warm_up",
]
