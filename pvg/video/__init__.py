"""Frames in and out: what a file is, its frames upright and exact in time, and clips and pictures written."""

from __future__ import annotations

from pvg.video.color import INPUT_COLORS, ColorSpace, InputColor, color_space, named_space
from pvg.video.containers import CLIP_SUFFIXES, CONTAINERS, PIPED
from pvg.video.describing import inspect, planned
from pvg.video.display_order import DisplayOrder, display_order, frame_at, key_pictures
from pvg.video.encoders import check_scales
from pvg.video.encoding import PictureEncoder
from pvg.video.file_state import FileState, file_state, sha256_file
from pvg.video.formats import RGB24, RGB48, Frame, Patch, PixelFormat
from pvg.video.images import IMAGE_SUFFIXES, read_image, write_image
from pvg.video.info import MediaInfo, probe
from pvg.video.joining import can_join, join
from pvg.video.keeping import make_plan
from pvg.video.metadata_record import PictureMetadata
from pvg.video.opening import MediaLimits
from pvg.video.parts import ClipOfParts, PartWriter
from pvg.video.picture_metadata import lost_in_picture, read_picture_metadata
from pvg.video.pipes import PipedClip, PipeReader
from pvg.video.plan import Plan
from pvg.video.planes import PlanePicture, picture_of
from pvg.video.reading import read_frames
from pvg.video.single_frames import SingleFrames
from pvg.video.sniffing import IMAGE_KINDS, sniff
from pvg.video.streams import Streams, read_streams
from pvg.video.writing import VideoWriter
from pvg.video.y4m import Y4mWriter

__all__ = [
    "CLIP_SUFFIXES",
    "CONTAINERS",
    "IMAGE_KINDS",
    "IMAGE_SUFFIXES",
    "INPUT_COLORS",
    "PIPED",
    "RGB24",
    "RGB48",
    "ClipOfParts",
    "ColorSpace",
    "DisplayOrder",
    "FileState",
    "Frame",
    "InputColor",
    "MediaInfo",
    "MediaLimits",
    "PartWriter",
    "Patch",
    "PictureEncoder",
    "PictureMetadata",
    "PipeReader",
    "PipedClip",
    "PixelFormat",
    "Plan",
    "PlanePicture",
    "SingleFrames",
    "Streams",
    "VideoWriter",
    "Y4mWriter",
    "can_join",
    "check_scales",
    "color_space",
    "display_order",
    "file_state",
    "frame_at",
    "inspect",
    "join",
    "key_pictures",
    "lost_in_picture",
    "make_plan",
    "named_space",
    "picture_of",
    "planned",
    "probe",
    "read_frames",
    "read_image",
    "read_picture_metadata",
    "read_streams",
    "sha256_file",
    "sniff",
    "write_image",
]
