"""What the networks are shown, and how far they are believed."""

from __future__ import annotations

from dataclasses import dataclass

from pvg.skin.parameters._range import Range


@dataclass(frozen=True)
class NetworkNumbers:
    """What the network is shown, and how far it is believed."""

    face_cells: float = 48.0  # cells a face size [by eye]: the network was trained so
    dark: float = 10.0  # 8-bit levels added before a logarithm [by eye]: as trained
    multiple: int = 16  # cells [by eye]: sides are multiples, for it halves four times
    sure: float = 0.001  # of probability [by eye]: nothing that is said is surer
    believed: float = 0.6  # of the log-odds, the rest the rules' [measured: 0.5 to 0.7 on pictures new to both]
    denied: float = 0.1  # of probability, up to which no place makes a cell skin [measured: 0.05 and 0.2 the same]
    sees: float = 0.33  # of the foreground at least [by eye]: a network that denies more does not see the face
    unlike: float = 0.3  # weight of the frame before in a cell [by eye], below which that changed since it was asked
    unsure: float = 0.2  # of probability [by eye]: at least what it said of such a cell counts as
    every: int = 4  # frames of a clip from one answer to the next [measured: mattes differ by 0.1 to 0.4 %]
    changed: float = 0.2  # of the cells, from which on it is asked at once [measured: at 0.25 occluders are tinted]


@dataclass(frozen=True)
class BodyNetworkNumbers:
    """What the networks of the body are shown, and how far they are believed; the rest is as of the face's."""

    face_cells: float = 24.0  # cells a face size at most [by eye]: the network was trained so
    seen_sizes: float = 9.0  # face sizes a side [by eye] of what features are told in: as trained
    seen_below: float = 2.0  # face sizes [by eye] that its middle lies below the head's: as trained
    seen_edge: float = 1.0  # face sizes [by eye] within which it counts less towards an end that is not the scene's
    far: float = 3.0  # face sizes [by eye]: farther places are hardly told apart; as trained
    rise: Range = (1.3, 1.6)  # of the face's oval, off which it counts [measured: from 1.1 on red ears lose 7 %]
    margin: int = 8  # cells around the scene [by eye]: in training more lay around it
    by_things: float = 0.5  # of the networks' log-odds, the rest by shapes [measured: of 0, 0.3, 0.5, 0.7 and 1 best]
    believed: float = 0.85  # of the log-odds, the rest the rules' [measured: from 0.9 on an arm is lost for a frame]


@dataclass(frozen=True)
class OutlineNumbers:
    """What the network that outlines one person is shown, and what follows from it."""

    sizes: float = 12.0  # face sizes a side [measured: of 7 to 14; out of narrower squares own arms reach]
    below: float = 3.0  # face sizes [measured: of 1.5 to 4] along the neck from the head's middle to the square's
    face: float = 0.9  # of the face's oval [by eye], where the outline has to be
    sees: float = 0.5  # of the face at least [by eye]: else it outlines somebody else, or nobody
    away: float = 2.0  # of the face's oval [by eye], from which on skin is worth asking whose it is
    off: float = 1.2  # of the face's oval [by eye], off which skin may be another's
    others: float = 0.3  # of the outline's mean, up to which a part is another's [measured: 0.3 to 0.45 the same]
    least: float = 0.1  # of a face size squared, of a part [measured: at 0.05 parts of own arms go]
    every: int = 12  # scenes of a clip [by eye] from one answer to the next
    answers: int = 6  # that the mean is of at most [measured: of 2 and 4 parts of others come and go]
    unlike: float = 0.3  # weight of the scene before in a cell [by eye], below which another thing is there
    stays: float = 0.1  # more of the mean for what was another's before [measured: at 0 parts come and go]
