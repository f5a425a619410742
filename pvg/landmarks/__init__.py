"""Faces of a clip: detect, fit, track and smooth, giving 106 landmarks and 88 skin points a frame."""

from __future__ import annotations

from pvg.landmarks.detector import detect_faces
from pvg.landmarks.drawing import draw_landmarks
from pvg.landmarks.identity import RATIOS, FaceShape, face_proportions, frontal_ratios, link_persons, proportions_of
from pvg.landmarks.mesh import Mesh, fit_landmarks, region_of_points
from pvg.landmarks.pose import head_pose
from pvg.landmarks.smoothing import smooth
from pvg.landmarks.tracking import LOOKBACK, MAX_FACES, FaceTracker, track_faces
from pvg.landmarks.tracks import FaceTrack, FaceTracks, OpenTrack

__all__ = [
    "LOOKBACK",
    "MAX_FACES",
    "RATIOS",
    "FaceShape",
    "FaceTrack",
    "FaceTracker",
    "FaceTracks",
    "Mesh",
    "OpenTrack",
    "detect_faces",
    "draw_landmarks",
    "face_proportions",
    "fit_landmarks",
    "frontal_ratios",
    "head_pose",
    "link_persons",
    "proportions_of",
    "region_of_points",
    "smooth",
    "track_faces",
]
