"""Single pictures, while somebody waits for them."""

from __future__ import annotations

from typing import Any, Literal

import httpx

from pvg_client.calls import Api, Flow, answered, understood
from pvg_client.media import path_of
from pvg_client.models import Look, Medium, id_of, said
from pvg_client.paths import path_to

Layer = Literal["image", "landmarks", "mask", "matte", "curves", "low", "high"]


def preview(
    api: Api,
    video: Medium | str,
    look: Look | Medium | str | None = None,
    *,
    frame: int | None = None,
    time_s: float | None = None,
    crop: tuple[int, int, int, int] | None = None,
    face: int | None = None,
    before: bool = False,
    nearest: bool = False,
    max_width: int | None = None,
    format: Literal["jpeg", "png"] | None = None,  # noqa: A002 - the service's word
) -> Flow[bytes]:
    """One frame of a video that is ready, with a look, as the bytes of a JPEG or a PNG.

    The look may be a reference alone; without one, or with ``before``, the frame is as it is. ``frame`` counts from 0,
    ``time_s`` is in seconds; without both the service takes one that shows the faces well. ``crop`` is x, y, width and
    height in pixels, ``face`` the index of one to show alone, ``nearest`` allows a frame beside that is sooner there.
    """
    asked = look if isinstance(look, Look) or look is None else Look(look)
    given: dict[str, Any] = {
        "look": None if asked is None else asked.body(),
        "frame": frame,
        "time_s": time_s,
        "crop": crop,
        "face": face,
        "before": before or None,
        "nearest": nearest or None,
        "max_width": max_width,
        "format": format,
    }
    body = {"video": id_of(video)} | said(given)
    # it changes nothing, so that it may be sent again without a key
    return (yield from _asked(api, api.request("POST", "/preview", body=body)))


def frame(api: Api, medium: Medium | str, number: int, *, layer: Layer = "image") -> Flow[bytes]:
    """A frame of a video or a reference that is ready, from 0, or a layer of it, as the bytes of a PNG."""
    where = path_of(id_of(medium)) + path_to("frames", str(number))
    return (yield from _asked(api, api.request("GET", where, params=[("layer", layer)])))


def poster(api: Api, medium: Medium | str) -> Flow[bytes]:
    """A small picture of a medium that is ready, as the bytes of a JPEG: its longer side is 640 px at most."""
    return (yield from _asked(api, api.request("GET", path_of(id_of(medium)) + "/poster")))


def thumbnail(api: Api, medium: Medium | str, face: int) -> Flow[bytes]:
    """A face of a medium that is ready, by its index, as the bytes of a JPEG of 160 by 160 px."""
    where = path_of(id_of(medium)) + path_to("faces", str(face), "thumbnail")
    return (yield from _asked(api, api.request("GET", where)))


def _asked(api: Api, request: httpx.Request) -> Flow[bytes]:
    return understood(request.url, _picture, (yield from answered(api, request)))


def _picture(response: httpx.Response) -> bytes:
    if not response.headers["content-type"].startswith("image/"):
        raise ValueError("it is no picture")
    return response.content
