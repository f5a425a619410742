"""What bodies look like: an example of each, shown in the schema. A test holds them against it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any, Final

from service.catalog import LookParams
from service.errors import ProblemType, problem_body

_VIDEO, _REFERENCE = "vid_0192f0c1a2b37c4d8e5f60718293a4b5", "ref_0192f0c1a2b37c4d8e5f60718293a4b6"
_JOB, _RESULT = "job_0192f0c1a2b37c4d8e5f60718293a4b7", "res_0192f0c1a2b37c4d8e5f60718293a4b8"
_UPLOAD, _MESSAGE = "upl_0192f0c1a2b37c4d8e5f60718293a4bb", "msg_0192f0c1a2b37c4d8e5f60718293a4bc"
_KEY: Final = "key_0192f0c1a2b37c4d8e5f60718293a4ba"
_SIGNATURE: Final = "mzDkJ6yWn0y2cSQH0cO3t0qZ0y1o7j4b5sI8x9Yd1Qk"
_REQUEST = "req_0192f0c1a2b37c4d8e5f60718293a4b9"
_SHA256: Final = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
_BEGAN, _ENDED, _GONE = "2026-01-05T10:00:00Z", "2026-01-05T10:00:20Z", "2026-01-12T10:00:20Z"
_SETTINGS: Final = {"mask": "landmarks", "matching": "table", "input_color": "auto"}

MEDIUM: Final[dict[str, Any]] = {
    "id": _VIDEO,
    "state": "ready",
    "job": _JOB,
    "filename": "clip.mp4",
    "content_type": "video/mp4",
    "size_bytes": 1830211,
    "sha256": _SHA256,
    "settings": _SETTINGS,
    "media": {
        "kind": "video",
        "width": 1280,
        "height": 720,
        "frame_rate": 30.0,
        "frame_count": 240,
        "duration_s": 8.0,
        "codec": "h264",
        "pixel_format": "yuv420p",
        "has_audio": True,
        "rotation": 0,
        "color": "SDR",
        "color_primaries": 1,
        "color_transfer": 1,
    },
    "faces": [
        {
            "index": 0,
            "first_frame": 0,
            "last_frame": 239,
            "width_px": 244.5,
            "skin_rgb": [199, 151, 128],
            "warnings": [],
            "frame": 120,
            "box": [502, 148, 244, 312],
            "thumbnail": f"/v1/videos/{_VIDEO}/faces/0/thumbnail",
        }
    ],
    "poster": f"/v1/videos/{_VIDEO}/poster",
    "warnings": [],
    "metadata": {"order": "42"},
    "error": None,
    "created_at": _BEGAN,
    "expires_at": "2026-02-04T10:00:00Z",
}
#: those of a look for which nothing is asked for
_OPTIONS: Final = {
    name: list(value) if isinstance(value, tuple) else value
    for name, value in asdict(LookParams()).items()
    if name != "exchange"
}
JOB: Final[dict[str, Any]] = {
    "id": _JOB,
    "kind": "transfer",
    "state": "succeeded",
    "done": True,
    "attempt": 1,
    "waiting_for": None,
    "progress": {"stage": "render", "fraction": 1.0, "frames_done": 240, "frames_total": 240},
    "queue": None,
    "eta": None,
    "media": None,
    "looks": [
        {
            "state": "succeeded",
            "video": _VIDEO,
            "reference": _REFERENCE,
            "options": _OPTIONS,
            "settings": _SETTINGS,
            "warnings": [],
            "result": _RESULT,
            "result_gone": None,
            "url": f"/v1/results/{_RESULT}",
            "size_bytes": 1913004,
            "content_type": "video/mp4",
            "sha256": _SHA256,
            "expires_at": _GONE,
            "extras": [
                {
                    "part": "look.cube",
                    "person": 1,
                    "url": f"/v1/results/{_RESULT}/look.cube",
                    "size_bytes": 970345,
                    "sha256": _SHA256,
                    "content_type": "text/plain",
                    "expires_at": _GONE,
                }
            ],
        }
    ],
    "output": {
        "container": None,
        "codec": "auto",
        "crf": None,
        "preset": None,
        "audio": "copy",
        "extras": ["cube"],
        "matte": "ffv1",
    },
    "error": None,
    "timings": {
        "waited_s": None,
        "queued_s": 0.2,
        "vectorize_s": None,
        "transfer_s": 1.9,
        "render_s": 16.4,
        "extras_s": 0.4,
        "store_s": 0.1,
    },
    "metadata": {"order": "42"},
    "traceparent": None,
    "created_at": _BEGAN,
    "started_at": _BEGAN,
    "finished_at": _ENDED,
    "expires_at": "2026-02-04T10:00:20Z",
}
_QUEUED: Final[dict[str, Any]] = {
    **JOB,
    "state": "queued",
    "done": False,
    "progress": {"stage": None, "fraction": 0.0, "frames_done": 0, "frames_total": 0},
    "queue": {"position": 3},
    "eta": {"seconds": 48.0, "low": 31.5, "high": 70.0},
    "looks": [
        {
            **JOB["looks"][0],
            "state": "queued",
            "settings": None,
            **dict.fromkeys(("result", "url", "size_bytes", "content_type", "sha256", "expires_at")),
            "extras": [],
        }
    ],
    "timings": None,
    **dict.fromkeys(("started_at", "finished_at", "expires_at")),
}

_UPLOADING: Final[dict[str, Any]] = {
    "id": _UPLOAD,
    "role": "video",
    "filename": "clip.mp4",
    "size_bytes": 1830211,
    "offset_bytes": 1048576,
    "media": None,
    "created_at": _BEGAN,
    "expires_at": "2026-01-06T10:00:00Z",
}
_DELIVERED: Final[dict[str, Any]] = {
    "id": _MESSAGE,
    "job": _JOB,
    "type": "job.succeeded",
    "url": "https://studio.example/hooks/pvg",
    "state": "delivered",
    "attempts": 1,
    "next_attempt_at": None,
    "last_attempt_at": _ENDED,
    "last_status": 204,
    "last_error": None,
    "created_at": _BEGAN,
    "delivered_at": _ENDED,
}
_BY_URL: Final = {"url": "https://media.example/clip.mp4", "metadata": {"order": "42"}}

#: examples of bodies, by the name of their model: what they show, and the body
EXAMPLES: Final[dict[str, dict[str, Any]]] = {
    "MediaBody": {"ready": MEDIUM},
    "MediaPage": {"a page": {"data": [MEDIUM], "next_cursor": None}},
    "JobBody": {"queued": _QUEUED, "succeeded": JOB},
    "JobPage": {"a page": {"data": [JOB], "next_cursor": None}},
    "TransferRequest": {
        "one look": {"video": _VIDEO, "looks": [{"reference": _REFERENCE}]},
        "two looks": {
            "video": _VIDEO,
            "looks": [
                {"reference": _REFERENCE},
                {"reference": _VIDEO, "strength": 0.7, "makeup": {"lips": 1, "lids": 0.3}, "faces": [0]},
            ],
            "output": {"codec": "h264", "crf": 18},
            "metadata": {"order": "42"},
        },
    },
    "SwapRequest": {
        "two videos": {"a": _VIDEO, "b": "vid_0192f0c1a2b37c4d8e5f60718293a4ba"},
        "two faces of one": {"a": _VIDEO, "faces": [0, 1], "contrast": [0.8, 1.2]},
    },
    "PreviewRequest": {
        "a look": {"video": _VIDEO, "look": {"reference": _REFERENCE, "strength": 0.7}, "time_s": 2.5},
        "a face as it is": {"video": _VIDEO, "face": 0, "max_width": 320, "format": "png"},
    },
    "VideoByUrl": {"a file": _BY_URL},
    "ReferenceByUrl": {"a file": _BY_URL | {"webhook": {"url": "https://studio.example/hooks/pvg"}}},
    "UploadBody": {
        "going on": _UPLOADING,
        "complete": _UPLOADING | {"offset_bytes": 1830211, "media": _VIDEO},
    },
    "UploadPage": {
        "a page": {
            "data": [
                _UPLOADING | {"url": f"/v1/uploads/{_UPLOAD}", "settings": _SETTINGS, "metadata": {"order": "42"}}
            ],
            "next_cursor": None,
        }
    },
    "UploadLinkRequest": {"a video": {"role": "video", "expires_in_s": 600, "max_bytes": 104857600}},
    "UploadLinkBody": {
        "a link": {
            "id": _UPLOAD,
            "url": f"/v1/uploads/{_UPLOAD}?expires=1767607800&by={_KEY}&signature={_SIGNATURE}",
            "expires_at": "2026-01-05T10:10:00Z",
            "max_bytes": 104857600,
        }
    },
    "ResultLinkRequest": {"the result": {"expires_in_s": 600}, "a part": {"part": "matte", "person": 1}},
    "LinkBody": {
        "a link": {
            "url": f"/v1/results/{_RESULT}?expires=1767607800&by={_KEY}&signature={_SIGNATURE}",
            "expires_at": "2026-01-05T10:10:00Z",
        }
    },
    "DeliveryBody": {
        "delivered": _DELIVERED,
        "tried again": _DELIVERED
        | {
            "state": "pending",
            "next_attempt_at": "2026-01-05T10:00:25Z",
            "last_status": 503,
            "last_error": "status 503",
            "delivered_at": None,
        },
    },
    "DeliveryPage": {"a page": {"data": [_DELIVERED], "next_cursor": None}},
    "SecretBody": {
        # the base64 of words that say so: no secret
        "a secret": {
            "secret": "whsec_YW4gZXhhbXBsZSwgbm90IGEgc2VjcmV0IGFueWJvZHk=",
            "created_at": _BEGAN,
            "former_valid_until": None,
        }
    },
    "Liveness": {"alive": {"status": "ok"}},
    "Readiness": {
        "ready": {"status": "ok", "checks": {"database": "ok", "storage": "ok", "broker": "ok", "workers": "ok"}}
    },
    "LimitsBody": {
        "with a key": {
            "key": {"requests_per_minute": 600, "active_jobs": 1000, "stored_bytes": 107374182400},
            "upload": {
                "bytes": 2147483648,
                "pixels": 33554432,
                "frames": 200000,
                "duration_s": 3600.0,
                "frame_rate": 240.0,
                "streams": 32,
                "face_px": 64,
                "advised_face_px": 200,
                "formats": ["mp4", "mov", "webm", "mkv", "avi", "jpeg", "png", "webp", "tiff"],
            },
            "request": {
                "json_bytes": 1048576,
                "looks": 16,
                "metadata": 16,
                "wait_s": 60,
                "page": 200,
                "idempotency_s": 86400.0,
            },
            "transport": {
                "fetches": 8,
                "fetch_s": 3600.0,
                "redirects": 5,
                "url_characters": 2048,
                "uploads": 1000,
                "pieces": 10000,
                "link_s": 604800,
                "streams": 100,
                "previews": 8,
                "preview_s": 10.0,
            },
            "output": {"clips": {"webm": ["vp9", "av1"]}, "pictures": ["png", "jpg"], "crf": {"h264": 51}},
            "retention": {
                "media_s": 2592000.0,
                "uploads_s": 86400.0,
                "results_s": 604800.0,
                "jobs_s": 2592000.0,
                "queued_s": 86400.0,
                "usage_months": 25,
            },
        }
    },
    "UsageBody": {
        "of a key": {
            "requests": {"used": 60, "limit": 600, "resets_s": 42},
            "active_jobs": {"used": 3, "limit": 1000},
            "stored_bytes": {"used": 5120334, "limit": 107374182400},
            "looks_this_month": 17,
            "jobs_this_month": {"succeeded": 12, "canceled": 1},
            "months": [
                {
                    "month": "2026-01",
                    "jobs": {"succeeded": 12, "canceled": 1},
                    "looks": 17,
                    "frames": 4080,
                    "duration_s": 136.0,
                    "uploads": 5,
                    "upload_bytes": 9151055,
                }
            ],
        }
    },
}
#: of texts, by operation
TEXTS: Final = {
    "get_job_events": 'retry: 2000\n\nid: running.5f1c0a9be3d24870\nevent: progress\ndata: {"id":"job_0192…",…}\n\n',
    "get_result_cube": 'TITLE "look"\nLUT_3D_SIZE 33\n0.000000 0.000000 0.000000\n',
    "get_metrics": '# TYPE pvg_jobs gauge\npvg_jobs{queue="render",state="queued"} 3.0\n',
}


def of_problems(kinds: Iterable[ProblemType], instance: str) -> dict[str, dict[str, Any]]:
    """An example of each kind of problem, by its code."""
    return {
        kind.type: problem_body(kind, kind.title) | {"instance": instance, "request_id": _REQUEST} for kind in kinds
    }
