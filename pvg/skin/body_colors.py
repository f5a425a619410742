"""What colours alone say of a person's skin off the face, as tables over R, G, B."""

from __future__ import annotations

import numpy as np

from pvg._arrays import Floats, smoothstep
from pvg.skin.color_model import LEAST_CHROMA, ColorScale, SkinColors, to_skin_lab
from pvg.skin.parameters import SKIN_PRIOR

_BODY = SKIN_PRIOR.body


def greyness(along: Floats, scale: ColorScale) -> Floats:
    """Nats against skin for the chroma that colours lack, by how far they are from the skin's along its hue.

    along: in spreads, of any shape, see `ColorScale.of_hue`.
    """
    chroma = max(float(np.hypot(*scale.center[1:])), LEAST_CHROMA)
    missing = np.maximum(0, _BODY.least_chroma - 1 - along * float(scale.spread[1:].mean()) / chroma)
    return np.asarray(_BODY.grey * missing**2 * min(1.0, chroma / SKIN_PRIOR.colors.full_chroma))


def color_tables(colors: SkinColors) -> tuple[Floats, Floats]:
    """Log-odds of skin by colour alone, everywhere and at the ears: (n, n, n) float32 at even steps of R, G, B to 255.

    Ears are thin and full of blood: they may be redder, darker and of more chroma than the face. In the shade of hair
    they are crimson, which hair itself hardly ever is.
    """
    levels = np.linspace(0, 255, _BODY.cube).astype(np.float32)
    grid = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).reshape(_BODY.cube, -1, 3)
    lab = to_skin_lab(np.asarray(grid, np.float32))
    center, spread = colors.scale.center, colors.scale.spread
    along, across = colors.scale.of_hue(lab)
    grey = greyness(along, colors.scale)
    away = (lab[..., 0] - center[0]) / spread[0]
    light = np.maximum(np.abs(away) - _BODY.light_free, 0) / _BODY.light
    seen = colors.evidence(lab)
    crimson = smoothstep(-across, *_BODY.ear_crimson) * smoothstep(along, *_BODY.ear_crimson_chroma) * (away < 0)

    def table(against: Floats | float, more: float, redder: float, blood: Floats | float = 0.0) -> Floats:
        """(n, n, n) log-odds.

        against: nats that the histograms count against skin at most;  more, redder: standard deviations away from grey
        and across the hue to red, in spreads;  blood: in [0, 1], how surely a dark red is that of an ear in shade.
        """
        squares = (along / np.where(along < 0, _BODY.along[0], more)) ** 2
        squares += (across / np.where(across < 0, redder, _BODY.across)) ** 2 + (1 - blood) * light**2
        by_histogram = _BODY.seen_weight * np.clip(seen, -against, _BODY.seen_for)
        odds = _BODY.base - 0.5 * squares - grey + by_histogram + _BODY.ear_blood * blood
        return np.ascontiguousarray(odds.reshape((_BODY.cube,) * 3), np.float32)

    # a wall beside an ear is no ear: only what has the face's chroma or more
    at_ears = np.where(along > 0, _BODY.ear_against, _BODY.seen_against)
    return (
        table(_BODY.seen_against, _BODY.along[1], _BODY.across),
        table(at_ears, _BODY.ear_along, _BODY.ear_redder, crimson),
    )
