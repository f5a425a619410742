"""What the service and the method both state, tied together: a change on one side alone fails here."""

from __future__ import annotations

import inspect
import struct
from collections.abc import Iterator
from dataclasses import asdict, fields
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast, get_args, get_type_hints

import av
import numpy as np
import pytest
from pydantic import ValidationError
from sqlalchemy import Table, UniqueConstraint

import pvg
import pvg_client
from pvg.asset import FaceSummary, MediaSummary, faces_by_index
from pvg.face import PARTS
from pvg.looks import MAKEUP
from pvg.rendering import LAYERS, MATTES, PART_S, SUITE_FILES, PictureFormat, can_join
from pvg.vectorization import STAGES
from pvg.video import CLIP_SUFFIXES, IMAGE_SUFFIXES, VideoWriter, encoders, probe, read_frames
from scripts.samples import Samples
from service.api.commands import stills
from service.api.openapi import TRANSFER_FORM
from service.api.routers import references, videos
from service.api.schemas import (
    LookOptions,
    MakeupParts,
    OptionsBody,
    OutputRequest,
    ReferenceOptions,
    VectorBody,
    VideoOptions,
)
from service.api.sniffing import HEAD_BYTES, sniff
from service.catalog import (
    LookParams,
    Media,
    OutputOptions,
    Progress,
    Report,
    ResumableUpload,
    VectorSettings,
    content_type_of,
)
from service.catalog.requests import (
    CLIP_CONTAINERS,
    HELD,
    IMAGE_CONTAINERS,
    MAX_CRF,
    Codec,
    Container,
    Extent,
    Extra,
    Feature,
    Layer,
    Match,
    MatteFormat,
    Preset,
    StillFormat,
    no_face,
)
from service.errors import PROBLEMS
from service.settings import Settings
from worker.answers import FaceAnswer, LookAnswer, MediaAnswer
from worker.failures import EXPECTED, problem_of
from worker.previews.previewer import SUFFIXES
from worker.progress import ProgressScale
from worker.rendering import spans_of_video
from worker.run import media_limits
from worker.sandbox import MethodError, calls
from worker.vectorizing import CLIP_SPANS, REFERENCE_SPANS

CODECS = get_args(Codec)
#: what no two media of an owner have in common
(UNIQUE,) = (
    one.columns.keys() for one in cast(Table, Media.__table__).constraints if isinstance(one, UniqueConstraint)
)
PRESETS = get_args(Preset)


def default_of(call: Any, name: str) -> Any:
    return inspect.signature(call).parameters[name].default


# the options of a look


def bounds(name: str) -> tuple[float, float]:
    """The least and the largest number that the API takes for an option."""
    schema = LookOptions.model_json_schema()["properties"][name]
    numbers = [part for part in schema.get("anyOf", [schema]) if part.get("type") == "number"]
    return numbers[0]["minimum"], numbers[0]["maximum"]


def taken_by_the_api(model: type[LookOptions] | type[OutputRequest], **options: Any) -> bool:
    try:
        model(**options)
    except ValidationError:
        return False
    return True


def taken_by_the_method(video: pvg.VectorVideo, reference: pvg.VectorVideo, **options: Any) -> bool:
    try:
        pvg.transfer(video, reference, **options)
    except ValueError:
        return False
    return True


def test_the_defaults_of_a_look_are_the_methods() -> None:
    params = asdict(LookParams())
    assert params.pop("exchange") is False  # the worker's own: `pvg.exchange` instead of `pvg.transfer`
    assert {name: default_of(pvg.transfer, name) for name in params} == params
    assert {name: default_of(pvg.transfer, name) for name in LookOptions.model_fields} == {
        name: tuple(value) if isinstance(value, list) else value for name, value in LookOptions().model_dump().items()
    }


def test_the_options_of_a_look_have_the_same_names_from_the_request_to_the_method() -> None:
    parameters = inspect.signature(pvg.transfer).parameters.values()
    names = {one.name for one in parameters if one.kind is one.KEYWORD_ONLY}
    assert LookOptions.model_fields.keys() == OptionsBody.model_fields.keys() == names
    assert {field.name for field in fields(LookParams)} - {"exchange"} == names
    assert {field.name for field in fields(pvg_client.Look)} - {"reference"} == names
    assert TRANSFER_FORM["properties"].keys() > names


@pytest.fixture(scope="module")
def portrait(samples: Samples) -> Iterator[pvg.VectorVideo]:
    """A still picture to be recoloured."""
    with pvg.vectorize(samples.portrait) as vectorized:
        yield vectorized


@pytest.mark.parametrize("name", ["strength", "contrast", "light", "makeup", "scene"])
def test_the_ranges_of_a_look_are_the_methods(
    portrait: pvg.VectorVideo, dark_reference: pvg.VectorVideo, name: str
) -> None:
    least, most = bounds(name)
    for value, expected in ((least, True), (most, True), (least - 0.01, False), (most + 0.01, False)):
        assert taken_by_the_api(LookOptions, **{name: value}) is expected
        assert taken_by_the_method(portrait, dark_reference, **{name: value}) is expected


def test_the_ranges_of_the_transport_are_the_methods(
    portrait: pvg.VectorVideo, dark_reference: pvg.VectorVideo
) -> None:
    for name, taken, refused in (
        ("beta", (0.01, 1.0), (0.0, 1.01)),
        ("iterations", (0, 1), (-1,)),
        ("seed", (0,), (-1,)),
    ):
        for value in taken:
            assert taken_by_the_api(LookOptions, **{name: value})
            assert taken_by_the_method(portrait, dark_reference, **{name: value})
        for value in refused:
            assert not taken_by_the_api(LookOptions, **{name: value})
            assert not taken_by_the_method(portrait, dark_reference, **{name: value})


def test_the_parts_of_makeup_are_the_methods(portrait: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    assert tuple(MakeupParts.model_fields) == PARTS
    assert MakeupParts().model_dump() == dict.fromkeys(PARTS, MAKEUP)
    for makeup in ({"lips": 1.0}, {"lips": 1.5}, {"nose": 1.0}, {}):
        taken = taken_by_the_method(portrait, dark_reference, makeup=makeup)
        assert taken is taken_by_the_api(LookOptions, makeup=makeup)


def test_the_settings_of_a_vectorisation_are_the_methods() -> None:
    defaults = asdict(VectorSettings())
    assert {name: default_of(pvg.vectorize, name) for name in defaults} == defaults == VideoOptions().model_dump()
    words, ours = get_type_hints(pvg.vectorize), get_type_hints(VectorSettings)
    for name in defaults:
        assert get_args(words[name]) == get_args(ours[name])


def test_the_settings_of_a_vectorisation_have_the_same_names_wherever_they_are_given_kept_and_told() -> None:
    names = {field.name for field in fields(VectorSettings)}
    assert VideoOptions.model_fields.keys() == VectorBody.model_fields.keys() == names
    assert ReferenceOptions.model_fields.keys() == names - {"matching"}
    for route, options in ((videos.create_video, VideoOptions), (references.create_reference, ReferenceOptions)):
        assert inspect.signature(route).parameters.keys() >= options.model_fields.keys()
    for record in (Media, ResumableUpload):
        assert {*record.__table__.columns.keys()} >= names
    assert {*UNIQUE} >= names, "the same bytes with other settings are another medium"
    for told in (Report, LookAnswer):
        assert get_type_hints(told).keys() > names
    for call in (pvg_client.Client.upload, pvg_client.Client.upload_link):
        assert inspect.signature(call).parameters.keys() > names


def test_the_words_of_a_look_are_the_methods(portrait: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    for match in (*get_args(Match), "exact"):
        assert taken_by_the_method(portrait, dark_reference, match=match) is taken_by_the_api(LookOptions, match=match)
    for extent in (*get_args(Extent), "arms"):
        taken = taken_by_the_api(LookOptions, extent=extent)
        assert taken_by_the_method(portrait, dark_reference, extent=extent) is taken
    for feature in (*get_args(Feature), "brows", "lips"):
        assert taken_by_the_method(portrait, dark_reference, protect=(feature,)) is taken_by_the_api(
            LookOptions, protect=[feature]
        )
    assert set(default_of(pvg.transfer, "protect")) == set(get_args(Feature))
    assert taken_by_the_method(portrait, dark_reference, contrast="auto")
    # the API checks indices against the faces that were found
    assert taken_by_the_method(portrait, dark_reference, faces=(0,))
    assert not taken_by_the_method(portrait, dark_reference, faces=(1,))


def test_as_many_looks_as_the_service_takes_are_rendered(
    portrait: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    look = pvg.transfer(portrait, dark_reference)
    paths = [tmp_path / f"{number}.jpg" for number in range(Settings().max_looks)]
    pvg.render(portrait, [look] * len(paths), paths)
    assert all(path.stat().st_size for path in paths)


# the options of the output


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four frames of 256x128, which every encoder takes."""
    path = tmp_path_factory.mktemp("tiny") / "tiny.mp4"
    write_clip(path, {})
    return path


def write_clip(path: Path, options: dict[str, str]) -> None:
    with av.open(str(path), "w", format="mp4", options=options) as output:
        stream = output.add_stream("libx264", rate=25)
        stream.width, stream.height = 256, 128
        stream.pix_fmt = "yuv420p"
        for level in range(4):
            picture = np.full((128, 256, 3), 40 * level, np.uint8)
            output.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        output.mux(stream.encode())


def written(tiny: Path, target: Path, **options: Any) -> bool:
    """Whether the method writes a clip with these options; False when it refuses them."""
    info = probe(tiny)
    try:
        with VideoWriter(target, info, info.format, **options) as writer:
            for frame in read_frames(tiny):
                writer.write(frame)
    except ValueError:
        return False
    return probe(target).frame_count == 4


def test_the_defaults_of_the_output_are_the_methods() -> None:
    defaults = asdict(OutputOptions())
    assert defaults.pop("container") is None
    assert defaults.pop("extras") == ()
    assert defaults.pop("matte") == default_of(pvg.export, "matte")
    assert {name: default_of(pvg.render, name) for name in defaults} == defaults
    assert {
        name: tuple(value) if isinstance(value, list) else value for name, value in OutputRequest().model_dump().items()
    } == asdict(OutputOptions())


def test_the_extras_are_the_parts_of_an_export() -> None:
    assert get_args(Extra) == SUITE_FILES
    # a folder of pictures is no download
    assert {*get_args(MatteFormat), "png"} == set(MATTES)
    for suffix, content_type in ((".cube", "text/plain"), (".mkv", "video/x-matroska"), (".mov", "video/quicktime")):
        assert content_type_of(suffix) == content_type


def test_every_container_is_one_that_the_method_writes() -> None:
    assert {f".{name}" for name in CLIP_CONTAINERS} <= set(CLIP_SUFFIXES)
    assert {f".{name}" for name in IMAGE_CONTAINERS} <= set(IMAGE_SUFFIXES)
    assert set(CLIP_CONTAINERS) | set(IMAGE_CONTAINERS) == set(get_args(Container))
    for name in get_args(Container):
        assert content_type_of(f".{name}").startswith("image/" if name in IMAGE_CONTAINERS else "video/")


@pytest.mark.parametrize("container", CLIP_CONTAINERS)
@pytest.mark.parametrize("codec", [*CODECS, "raw", "mjpeg"])
def test_a_container_holds_the_codecs_that_the_method_puts_into_it(
    tiny: Path, tmp_path: Path, container: str, codec: str
) -> None:
    taken = taken_by_the_api(OutputRequest, container=container, codec=codec)
    assert written(tiny, tmp_path / f"out.{container}", codec=codec) is taken


@pytest.mark.parametrize(
    ("codec", "container", "most"),
    [
        ("h264", "mp4", 51),
        ("hevc", "mp4", 51),
        ("vp9", "webm", 63),
        ("av1", "mkv", 63),
        ("auto", "webm", 63),
        ("auto", "mp4", 51),
    ],
)
def test_the_crf_reaches_as_far_as_the_encoder(
    tiny: Path, tmp_path: Path, codec: str, container: str, most: int
) -> None:
    for crf in (0, most):
        assert taken_by_the_api(OutputRequest, codec=codec, container=container, crf=crf)
        assert written(tiny, tmp_path / f"out{crf}.{container}", codec=codec, crf=crf)
    for crf in (-1, most + 1):
        assert not taken_by_the_api(OutputRequest, codec=codec, container=container, crf=crf)


def test_the_codecs_are_the_methods_but_for_those_of_pipes() -> None:
    assert {*CODECS, "raw"} == set(get_args(encoders.Codec))
    assert set(HELD) == set(CLIP_CONTAINERS)
    assert {name: one.crf_most for name, one in encoders.ENCODERS.items() if one.crf is not None} == MAX_CRF


def test_the_qualities_and_efforts_that_are_usual_are_said_in_numbers() -> None:
    scales = {name: one for name, one in encoders.ENCODERS.items() if one.crf is not None}
    qualities = ", ".join(f"{one.crf} ({name})" for name, one in scales.items())
    assert qualities in (Path(__file__).parents[2] / "docs" / "api.md").read_text()
    assert qualities in str(OutputRequest.model_fields["crf"].description)
    assert qualities.replace(", 26", " or 26") in " ".join(str(pvg.render.__doc__).split())
    for codec in scales:
        said = encoders.encoder_options(codec, None, "veryfast")
        assert said == encoders.encoder_options(codec, None, None), "veryfast is the effort that is not asked for"
    assert "veryfast" in str(OutputRequest.model_fields["preset"].description)


def test_parts_are_as_long_as_the_method_says_and_all_that_clips_are_written_as_can_be_joined() -> None:
    assert Settings().part_s == PART_S
    assert all(can_join(container, codec) for container in HELD for codec in ("auto", *HELD[container]))


@pytest.mark.parametrize("codec", [codec for codec in CODECS if codec not in {"auto", *MAX_CRF}])
@pytest.mark.parametrize("option", [{"crf": 20}, {"preset": "fast"}])
def test_a_scale_that_a_codec_has_not_is_refused_by_both(
    tiny: Path, tmp_path: Path, codec: str, option: dict[str, Any]
) -> None:
    container = next(name for name, held in HELD.items() if codec in held)
    assert taken_by_the_api(OutputRequest, container=container, codec=codec)
    assert not taken_by_the_api(OutputRequest, container=container, codec=codec, **option)
    assert not written(tiny, tmp_path / f"out.{container}", codec=codec, **option)


@pytest.mark.parametrize("codec", list(MAX_CRF))
def test_every_preset_is_known_to_every_encoder(tiny: Path, tmp_path: Path, codec: str) -> None:
    for preset in PRESETS:
        assert written(tiny, tmp_path / f"{preset}.mkv", codec=codec, preset=preset)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_face_that_is_not_there_is_told_in_the_same_words(count: int) -> None:
    video = cast(pvg.VectorVideo, SimpleNamespace(faces=[SimpleNamespace(index=index) for index in range(count)]))
    with pytest.raises(ValueError, match="no face") as raised:
        faces_by_index(video, [0, count + 1], what="reference")
    assert str(raised.value) == no_face(count + 1, count, "this reference")


# what is taken in


def test_the_limits_of_the_service_are_the_methods() -> None:
    assert pvg.MediaLimits(**media_limits(Settings())) == pvg.MediaLimits()  # type: ignore[arg-type]
    assert {field.name for field in fields(pvg.MediaLimits)} <= Settings.model_fields.keys()
    assert Settings().min_face_px == default_of(pvg.vectorize, "min_face_px")
    assert Settings().warn_face_px == default_of(pvg.vectorize, "advised_face_px")


def opened(path: Path) -> bool:
    """Whether the method reads all of a file."""
    try:
        return sum(1 for _ in read_frames(path)) == 4
    except pvg.MediaError:
        return False


def boxes_of(content: bytes) -> list[tuple[bytes, bytes]]:
    found, start = [], 0
    while start < len(content):
        size, kind = struct.unpack(">I4s", content[start : start + 8])
        found.append((kind, content[start : start + size]))
        start += size
    return found


@pytest.mark.parametrize(
    "box", [b"ftyp", b"styp", b"wide", b"free", b"skip", b"pnot", b"mdat", b"sidx", b"uuid", b"abcd"]
)
def test_a_first_box_is_taken_exactly_when_the_method_opens_the_file(tiny: Path, tmp_path: Path, box: bytes) -> None:
    content = tiny.read_bytes()
    assert content[4:8] == b"ftyp"
    path = tmp_path / "clip.mp4"
    path.write_bytes(content[:4] + box + content[8:])
    assert (sniff(path.read_bytes()[:HEAD_BYTES]) is not None) is opened(path)


@pytest.mark.parametrize(
    ("order", "first"), [("is", b"styp"), ("i", b"moov"), ("f", b"moof")], ids=["styp", "index first", "fragment first"]
)
def test_a_fragmented_clip_is_taken_exactly_when_the_method_opens_it(tmp_path: Path, order: str, first: bytes) -> None:
    whole = tmp_path / "whole.mp4"
    write_clip(whole, {"movflags": "frag_keyframe+empty_moov+default_base_moof"})
    boxes = boxes_of(whole.read_bytes())
    index = b"".join(body for kind, body in boxes if kind == b"moov")
    fragments = b"".join(body for kind, body in boxes if kind in {b"moof", b"mdat"})
    styp = struct.pack(">I4s4sI4s", 20, b"styp", b"msdh", 0, b"msdh") if "s" in order else b""
    path = tmp_path / "clip.mp4"
    path.write_bytes(styp + (fragments + index if order == "f" else index + fragments))
    head = path.read_bytes()[:HEAD_BYTES]
    assert head[4:8] == first
    assert (sniff(head) is not None) is opened(path)


HEADS = [
    b"",
    b"hello",
    b"\xff\xd8\xff\xe0\x00\x10JFIF",
    b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR",
    b"RIFF\x00\x00\x00\x00WEBPVP8 ",
    b"RIFF\x00\x00\x00\x00WEBPVP8L",
    b"RIFF\x00\x00\x00\x00WEBPVP8X\x0a\x00\x00\x00\x10\x00\x00\x00",
    b"RIFF\x00\x00\x00\x00WEBPVP8X\x0a\x00\x00\x00\x12\x00\x00\x00",
    b"RIFF\x00\x00\x00\x00AVI LIST",
    b"RIFF\x00\x00\x00\x00WAVEfmt ",
    b"\x1aE\xdf\xa3\x01\x00\x00\x00\x00\x00\x00\x1fB\x82\x84webm",
    b"\x1aE\xdf\xa3\x01\x00\x00\x00\x00\x00\x00\x23B\x82\x88matroska",
    *(b"\x00\x00\x00\x18ftyp" + brand for brand in (b"isom", b"mp42", b"qt  ", b"M4V ", b"dash", b"3gp4")),
    *(
        b"\x00\x00\x00\x18ftyp" + brand
        for brand in (b"heic", b"heix", b"hevc", b"mif1", b"msf1", b"avif", b"avis", b"crx ")
    ),
    b"GIF89a",
    b"#EXTM3U\n#EXT-X-VERSION:3",
    b"ffconcat version 1.0\nfile /etc/passwd",
    b"<svg xmlns='http://www.w3.org/2000/svg'/>",
    b"%PDF-1.7",
    b"II*\x00",
    b"MM\x00*",
    b"II+\x00\x08\x00\x00\x00",
    b"MM\x00+\x00\x08\x00\x00",
    b"OggS",
    b"BM",
    b"\x47\x40\x00",
]


@pytest.mark.parametrize("head", HEADS)
def test_the_same_first_bytes_are_taken(tmp_path: Path, head: bytes) -> None:
    path = tmp_path / "file"
    path.write_bytes(head)
    try:
        kind: str | None = pvg.video.sniff(path)
    except pvg.MediaError:
        kind = None
    found = sniff(head)
    assert (found is not None) is (kind is not None)
    if found is not None:
        assert found.content_type.startswith("image/") is (kind in {"jpeg", "png", "webp", "tiff"})


# stages and errors


def test_every_stage_of_the_vectoriser_has_its_part_of_a_job_in_its_order() -> None:
    assert (*CLIP_SPANS, *REFERENCE_SPANS) == STAGES


@pytest.mark.parametrize(
    "spans",
    [
        CLIP_SPANS,
        REFERENCE_SPANS,
        spans_of_video(0, 1),
        spans_of_video(1, 2),
        spans_of_video(0, 1, ["cube"]),
        spans_of_video(1, 2, ["cube", "matte"]),
    ],
)
def test_progress_moves_in_every_stage_and_leaves_room_for_storing(spans: dict[str, tuple[float, float]]) -> None:
    seen: list[Progress] = []
    scale = ProgressScale(seen.append)
    scale.expect(spans)
    for stage in spans:
        for done in range(1, 5):
            scale(stage, done, 4)
    fractions = [progress.fraction for progress in seen]
    assert all(later > earlier for earlier, later in pairwise(fractions))
    assert fractions[-1] < 1


def test_the_stages_that_are_named_are_those_expected(short_clip: Path, tmp_path: Path) -> None:
    named: list[str] = []

    def note(stage: str, done: int, total: int) -> None:
        named.append(stage)

    def stages() -> list[str]:
        found = list(dict.fromkeys(named))
        named.clear()
        return found

    with pvg.vectorize(short_clip, reference=True, progress=note) as reference:
        assert stages() == list(REFERENCE_SPANS)
        with pvg.vectorize(short_clip, progress=note) as video:
            assert stages() == ["vectorize"]  # no track of this clip needs a second reading
            pvg.render(video, [pvg.transfer(video, reference)], [tmp_path / "out.mp4"], progress=note)
            assert stages() == [stage for stage in spans_of_video(0, 1) if stage != "transfer"]  # the worker's own


def test_every_error_of_the_method_is_a_problem_of_the_service() -> None:
    errors = [one for one in vars(pvg).values() if isinstance(one, type) and issubclass(one, pvg.PvgError)]
    assert len(errors) >= 7
    for error in errors:
        problem = problem_of(MethodError(error.__name__, "x"))
        assert problem["title"] == PROBLEMS[problem["type"]].title
    known = {error.__name__ for error in [*errors, calls.OptionError, calls.AbsentFaceError]}
    assert known >= EXPECTED.keys()


def test_the_answers_that_are_taken_are_those_of_the_method() -> None:
    assert MediaAnswer.model_fields.keys() == {field.name for field in fields(MediaSummary)}
    seen = {"frame", "box"}  # added by the call itself
    assert FaceAnswer.model_fields.keys() - seen == {field.name for field in fields(FaceSummary)} - {"person"}
    assert set(calls._SHOWN) == FaceAnswer.model_fields.keys() - seen


def test_the_pictures_that_are_asked_for_are_those_of_the_method() -> None:
    assert get_args(Layer) == LAYERS
    assert get_args(StillFormat) == get_args(PictureFormat)
    assert set(SUFFIXES) == set(stills.MEDIA_TYPES) == set(get_args(StillFormat))
    assert (stills.POSTER_PX, stills.THUMBNAIL_PX) == (calls.POSTER_PX, calls.THUMBNAIL_PX)
