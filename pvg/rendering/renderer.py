"""Draws the looks of one clip into its frames."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg.asset import VectorVideo
from pvg.curves import Chain, ColorTable, CurveLabels, labels_by_length, table_labels
from pvg.errors import UncutError
from pvg.face import Landmarks
from pvg.looks import Look, Region, check_looks
from pvg.rendering.beard import with_beard
from pvg.rendering.beside import BesideTables, with_beside
from pvg.rendering.blocks import Blocks
from pvg.rendering.body import apply_body
from pvg.rendering.coding import Coding
from pvg.rendering.correction import CurveCorrection, at_curves, extend
from pvg.rendering.edges import follow_edges, follows_edges
from pvg.rendering.foreground import foreground
from pvg.rendering.foreign import own_tables, skin_of, without_foreign
from pvg.rendering.guards import Guard, guard_gain, guarded_alpha
from pvg.rendering.makeup import with_parts
from pvg.rendering.map_tables import MapTables
from pvg.rendering.mouth import see_mouth
from pvg.rendering.neck import without_chest
from pvg.rendering.placed_body import PlacedBody, place_body
from pvg.rendering.placed_face import PlacedFace, add_alpha, divide_overlaps, place_face
from pvg.rendering.plane_samples import OverChroma
from pvg.rendering.planes import apply_correction, fade_in_dark
from pvg.video import Frame, Patch

_GUARDED = np.float32(0.7)  # of a look that eyes and teeth are said to take where only a matte tells it
_REGIONS: tuple[Region, ...] = ("face", "beside", "ears")
_CHAIN_SPACING_PX = 2.0  # between the samples of the paper's chain


class _TableColors:
    """g and every look's g' of one face by the clip-wide table, going over from key frame to key frame."""

    def __init__(self, video: VectorVideo, face: int, stacks: Sequence[Floats]) -> None:
        self._record = video.records[face]
        self._tables = [ColorTable(colors, table_labels()) for colors in stacks]

    def at(self, frame: int) -> tuple[CurveLabels, Floats]:
        """Labels in `frame`, and (S, 3 + 3n) g beside g' of n looks."""
        tables = [table.at(table_labels()) for table in self._tables]
        return table_labels(), self._record.blended(tables, frame)


class _ChainColors:
    """The same by the paper's frame-to-frame chain, which starts anew at every key frame."""

    def __init__(self, video: VectorVideo, face: int, stacks: Sequence[Floats]) -> None:
        self._video, self._face, self._record = video, face, video.records[face]
        self._stacks = stacks
        self._chain: tuple[int, int, Chain, CurveLabels] | None = None  # key, frame, chain, labels

    def at(self, frame: int) -> tuple[CurveLabels, Floats]:
        """The same; S differs from frame to frame."""
        key = self._record.key_frames.index(self._record.key_frame_of(frame))
        first = self._record.key_frames[key].frame
        if frame < first:  # before the first key frame of all: the chain begins there
            return table_labels(), self._stacks[key]
        if self._chain is None or self._chain[0] != key or self._chain[1] >= frame:
            self._chain = (key, first - 1, Chain(self._stacks[key], table_labels()), table_labels())
        _, last, chain, labels = self._chain
        colors = self._stacks[key]
        for i in range(last + 1, frame + 1):
            data = self._video.face_at(self._face, i)
            if data is not None:
                labels = labels_by_length(data.landmarks, data.boundary, spacing_px=_CHAIN_SPACING_PX)
                colors = chain.step(labels)
        self._chain = (key, frame, chain, labels)
        return labels, colors


def _propagation(video: VectorVideo, face: int, looks: Sequence[Look]) -> _TableColors | _ChainColors:
    """How g and the looks' g' of a face get to each frame, as the clip was vectorised for."""
    stacks = [
        np.concatenate([key.colors, *(look.colors[face][k] for look in looks)], axis=1)
        for k, key in enumerate(video.records[face].key_frames)
    ]
    return (_ChainColors if video.settings["matching"] == "chain" else _TableColors)(video, face, stacks)


_Placed = TypeVar("_Placed", PlacedFace, PlacedBody)
_Faces = list[tuple[int, PlacedFace, Floats | None]]  # each face, where it is, and its colours, if a look draws it
_Kind = tuple[tuple[str, ...], bool]  # of mattes: what is protected, and whether a map stands for λ


@dataclass(frozen=True, eq=False)
class _Asked:
    """What a look asks for in one face of a frame, in luma and chroma of the frame's codes, black aside.

    look: its number;  at_curves: the correction where it is known;  luma: (S,) of g';  parts: (P, 3) what parts gain,
    None for nothing;  beside: the tables of skin beside the face, None where λ is a number.
    """

    look: int
    at_curves: CurveCorrection
    luma: Floats
    parts: Doubles | None
    beside: BesideTables | None


class _Mattes:
    """The mattes of one face for the looks that draw it, each kind told once.

    faces: the face for those with a number for λ and with a map;  mouth: see `guarded_alpha`;  in_place: whether there
    is but one kind.
    """

    def __init__(self, faces: Mapping[bool, PlacedFace], mouth: Floats | None, align: int, *, in_place: bool) -> None:
        self._faces, self._mouth, self._align, self._in_place = faces, mouth, align, in_place
        self._guarded: dict[_Kind, tuple[Floats, list[Guard]]] = {}
        self._to_the_neck: dict[_Kind, Floats] = {}

    def guarded(self, kind: _Kind) -> tuple[Floats, list[Guard]]:
        """The matte (h, w) without what is protected, and that."""
        if kind not in self._guarded:
            protect, mapped = kind
            self._guarded[kind] = guarded_alpha(
                self._faces[mapped], protect, self._mouth, in_place=self._in_place, align=self._align
            )
        return self._guarded[kind]

    def to_the_neck(self, kind: _Kind) -> tuple[Floats, list[Guard]]:
        """The same for looks that leave the person's other skin."""
        alpha, guards = self.guarded(kind)
        if kind not in self._to_the_neck:
            self._to_the_neck[kind] = without_chest(self._faces[False], alpha)
        return self._to_the_neck[kind], guards


class Renderer:
    """Draws the looks of one clip into its frames; frames may come in any order.

    Raises `ValueError` for a look of another clip.
    """

    def __init__(self, video: VectorVideo, looks: Sequence[Look]) -> None:
        check_looks(video, looks)
        self.video = video
        self.looks = tuple(looks)
        faces = sorted({face for look in looks for face in look.colors})
        self._follows = follows_edges(video)
        # numbers, since one look may be asked for twice
        self._with_face = {face: [i for i, look in enumerate(looks) if face in look.colors] for face in faces}
        self._with_body: dict[int, list[int]] = {}
        for i, look in enumerate(looks):
            for face in (face for face in sorted(look.body) if look.maps[face].strength > 0):
                self._with_body.setdefault(face, []).append(i)
        # first and last frame of every face, of which a clip with many cuts has hundreds
        self._spans = np.array([(face.first_frame, face.last_frame) for face in video.faces]).reshape(-1, 2)
        # by look, face and region: the light that the tables were made for, and they
        self._tables: dict[tuple[int, int, Region], tuple[tuple[float, ...], MapTables]] = {}
        self._own: dict[int, tuple[Floats | None, MapTables | None]] = {}  # of faces, their skin and its tables
        self._colors = {
            face: _propagation(video, face, [looks[i] for i in which]) for face, which in self._with_face.items()
        }

    def draw(self, frame: Frame) -> list[Frame]:
        """One frame for every look, in their order; untouched frames are `frame` itself."""
        return [frame.patched(patches) for patches in self.patches(frame)]

    def patches(self, frame: Frame) -> list[list[Patch]]:
        """What every look changes in the frame, in their order, each to be laid over it in its order."""
        out: list[list[Patch]] = [[] for _ in self.looks]
        faces = self._placed_faces(frame)
        bodies = self._placed_bodies(frame, faces)  # before guards are taken out of the faces' mattes
        for face, placed, colors in faces:
            if colors is not None:
                self._draw_face(frame, face, placed, colors, out)
        for face, body in bodies:
            shown = foreground(frame, (body.x, body.y), body.alpha, body.step)
            for i in self._with_body[face]:
                tables = self._tables_of(i, face, frame, "beside")
                out[i] += apply_body(frame, body, shown, tables, under=out[i])
        return out

    def mattes(self, frame: Frame, look: int, persons: Sequence[Collection[int]]) -> list[Floats]:
        """(H, W) float32 in [0, 1] for the faces of each person: how far each pixel takes a look of theirs.

        What guards keep follows the look in brightness above all: it takes a part of it.
        """
        placed = self._placed_faces(frame)
        bodies = self._placed_bodies(frame, placed)
        out = []
        for faces in persons:
            total = np.zeros((frame.height, frame.width), np.float32)
            for face, whole, _ in placed:
                if face in faces:
                    one = self._mapped_skin(frame, face, whole, [look])
                    alpha, guards = guarded_alpha(one, self.looks[look].protect)
                    alpha = alpha if face in self.looks[look].body else without_chest(one, alpha)
                    add_alpha(total, one.x, one.y, alpha)
                    for guard in guards:
                        add_alpha(total, one.x + guard.x, one.y + guard.y, _GUARDED * guard.weight)
            for face, body in bodies:
                if face in faces and face in self.looks[look].body:
                    add_alpha(total, body.x, body.y, body.alpha)
            out.append(np.minimum(total, np.float32(1.0)))
        return out

    def _mapped_skin(self, frame: Frame, face: int, placed: PlacedFace, looks: Sequence[int]) -> PlacedFace:
        """A face as those of some looks draw it that have a map of colour for λ; the same when none has."""
        mapped = any(self.looks[i].contrast_of(face) == "map" for i in looks)
        return self._in_skin_colors(frame, placed, face, placed.data.landmarks) if mapped else placed

    def _in_skin_colors(self, frame: Frame, placed: _Placed, face: int, landmarks: Landmarks) -> _Placed:
        """A face, or a piece of its person's body, without what is coloured as no skin is."""
        tables = self._own_tables_of(face, frame)
        alpha = without_foreign(frame, (placed.x, placed.y), placed.alpha, tables, landmarks)
        return placed if alpha is placed.alpha else replace(placed, alpha=alpha)

    def _own_tables_of(self, face: int, frame: Frame) -> MapTables | None:
        skin = skin_of(self.video.records[face], frame.index)
        before, tables = self._own.get(face, (None, None))
        if skin is not before:
            tables = None if skin is None else own_tables(skin, frame.format)
            self._own[face] = skin, tables
        return tables

    def _placed_bodies(self, frame: Frame, faces: _Faces) -> list[tuple[int, PlacedBody]]:
        """(face, where the person's other skin is) of every face in the frame that a look draws with its body.

        What is coloured as no skin is left out. Where two persons' mattes overlap the first keeps what it has, so those
        that no look draws are placed too, as far as one that is drawn comes after them.
        """
        placed_faces = [placed for _, placed, _ in faces]
        end = max((k for k, (face, _, _) in enumerate(faces, 1) if face in self._with_body), default=0)
        out: list[tuple[int, PlacedBody]] = []
        for face, placed, _ in faces[:end]:
            bodies = place_body(frame, placed.data.body, placed_faces, [other for _, other in out])
            out += [(face, body) for body in bodies]
        landmarks = {face: placed.data.landmarks for face, placed, _ in faces}
        return [
            (face, self._in_skin_colors(frame, body, face, landmarks[face]))
            for face, body in out
            if face in self._with_body
        ]

    def _tables_of(self, look: int, face: int, frame: Frame, region: Region) -> MapTables:
        look_map = self.looks[look].maps[face]
        light = tuple(self.video.records[face].blended(look_map.exposures, frame.index).tolist())
        before, tables = self._tables.get((look, face, region), (None, None))
        if tables is None or before != light:
            gain, kept, *tint = light
            tables = MapTables.of(look_map, frame.format, gain, kept, tint, region=region)
            self._tables[look, face, region] = light, tables
        return tables

    def _placed_faces(self, frame: Frame) -> _Faces:
        """(face, where it is, its colours) of every face in the frame; one that no look draws has no colours.

        They are needed too: a face in front of another is not painted with that one's look.
        """
        align = frame.format.chroma_step
        found: _Faces = []
        there = (self._spans[:, 0] <= frame.index) & (frame.index <= self._spans[:, 1])
        for face in np.flatnonzero(there).tolist() if self._with_face else ():
            data = self.video.face_at(face, frame.index)
            if data is None:
                continue
            labels, colors = self._colors[face].at(frame.index) if face in self._colors else (table_labels(), None)
            placed = place_face(data, labels, frame.width, frame.height, align)
            if placed is not None:
                found.append((face, follow_edges(placed, frame) if self._follows else placed, colors))
        divided = divide_overlaps([placed for _, placed, _ in found])
        return [(face, placed, colors) for (face, _, colors), placed in zip(found, divided, strict=True)]

    def _draw_face(self, frame: Frame, face: int, placed: PlacedFace, colors: Floats, out: list[list[Patch]]) -> None:
        """Draw one face with its looks;  colors: (S, 3 + 3n), g and g' of each look."""
        which, g = self._with_face[face], Coding(frame.format).colors(colors[:, :3])
        asked = [self._asked(i, face, frame, g, colors[:, 3 * k : 3 * (k + 1)]) for k, i in enumerate(which, start=1)]
        level = 2.0 ** (frame.format.depth - 8)
        try:
            corrections = extend(placed, g, [one.at_curves for one in asked], level=level)
        except UncutError:  # a speck of matte between curves, as the paper's rule may leave: it stays as it is
            return
        mapped = self._mapped_skin(frame, face, placed, which)
        landmarks, lattice = placed.data.landmarks, corrections[0].lattice
        mouth = see_mouth(frame, landmarks, self.video.records[face].key_frame_of(frame.index), lattice)
        corrections = with_parts(corrections, [one.parts for one in asked], landmarks, mouth.lips)
        blocks = Blocks.of(frame, mapped, lattice)
        corrections = with_beard(blocks, with_beside(blocks, corrections, [one.beside for one in asked]))

        corner, skin = (placed.x, placed.y), None
        if any(correction.mapped for correction in corrections):
            skin = foreground(frame, corner, mapped.alpha, placed.data.matte.raster.step)
        fade = fade_in_dark(frame, corner, mapped.alpha, corrections, skin)
        kinds = [(self.looks[i].protect, correction.mapped) for i, correction in zip(which, corrections, strict=True)]
        faces = {False: placed, True: mapped}
        mattes = _Mattes(faces, mouth.skin, frame.format.chroma_step, in_place=len(set(kinds)) == 1)
        over = OverChroma(frame.format)
        for one, kind, correction in zip(asked, kinds, corrections, strict=True):
            with_body, under = face in self.looks[one.look].body, out[one.look]
            alpha, guards = mattes.guarded(kind) if with_body else mattes.to_the_neck(kind)
            if correction.mapped:
                gains = [(guard, guard_gain(guard, placed, g[:, 0], one.luma, level)) for guard in guards]
                under += apply_correction(
                    frame, corner, alpha, correction, under=under, guards=gains, fade=fade, skin=skin, over_chroma=over
                )
            else:  # λ as a number is the paper's: what changes in the clip survives exactly, in eyes and teeth too
                under += apply_correction(frame, corner, alpha, correction, under=under, over_chroma=over)

    def _asked(self, look: int, face: int, frame: Frame, g: Floats, new: Floats) -> _Asked:
        """What a look asks for in a face;  g: (S, 3) luma and chroma;  new: (S, 3) g', RGB."""
        coding, contrast, parts = Coding(frame.format), self.looks[look].contrast_of(face), None
        new_codes = coding.colors(new)
        if face in self.looks[look].parts:
            gained = self.video.records[face].blended(self.looks[look].parts[face], frame.index)
            parts = coding.changes(gained, new)
        if contrast != "map":
            return _Asked(look, at_curves(g, new_codes, contrast), new_codes[:, 0], parts, None)
        tables, neck, ears = (self._tables_of(look, face, frame, region) for region in _REGIONS)
        return _Asked(look, at_curves(g, new_codes, tables), new_codes[:, 0], parts, BesideTables(neck, ears))
