"""Frames in and out: what a file is, its frames upright and exact in time, and clips and pictures written."""

from __future__ import annotations

from pvg.video.formats import RGB24, Frame, Patch, PixelFormat
from pvg.video.images import IMAGE_SUFFIXES, read_image, write_image
from pvg.video.info import MediaInfo, probe, sha256_file
from pvg.video.opening import MediaLimits
from pvg.video.planes import PlanePicture, picture_of
from pvg.video.reading import read_frames
from pvg.video.sniffing import sniff
from pvg.video.writing import CLIP_SUFFIXES, VideoWriter

__all__ = [
    "CLIP_SUFFIXES",
    "IMAGE_SUFFIXES",
    "RGB24",
    "Frame",
    "MediaInfo",
    "MediaLimits",
    "Patch",
    "PixelFormat",
    "PlanePicture",
    "VideoWriter",
    "picture_of",
    "probe",
    "read_frames",
    "read_image",
    "sha256_file",
    "sniff",
    "write_image",
]
