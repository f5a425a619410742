"""What each kind of problem means and what to do about it: the page at /docs/problems."""

from __future__ import annotations

from typing import Final

#: meaning, and what to do, by the code of the problem
ADVICE: Final[dict[str, tuple[str, str]]] = {
    "malformed": (
        "The request cannot be read: it is not valid HTTP or JSON, the form is broken, a header field is malformed, or "
        "the bytes do not match the digest that came with them.",
        "Correct what `detail` names. The same request would fail again.",
    ),
    "unauthorized": (
        "The service has keys, and the request has none, or one that is unknown, replaced or revoked. Or the service "
        "has no keys, and the request has one.",
        "Send `Authorization: Bearer` with a key that `pvg-service keys create` has printed. To a service without "
        "keys, send no `Authorization`.",
    ),
    "forbidden": (
        "A page of another site tried to write. Or the request uses a signed link that was altered, whose key was "
        "revoked or has another secret now, or whose file belongs to another key now.",
        "To let a page write, add its origin to `PVG_ALLOWED_ORIGINS`, or make the request from a program. If it is "
        "the link, ask for another one.",
    ),
    "not-found": (
        "There is nothing with this id, or at this address, that this key can see. What belongs to another key is "
        "answered in the same way.",
        "Check the id, the address and the key. What was deleted or has expired is not found either.",
    ),
    "method-not-allowed": (
        "The address does not support this method.",
        "Use one of the methods in the `Allow` field of the answer.",
    ),
    "too-slow": (
        "The head or the body of the request came too slowly. The connection was closed.",
        "Send the request again over a better connection. Send large files in pieces, by /v1/uploads: these go on "
        "where they broke.",
    ),
    "conflict": (
        "The state of the resource does not allow this: it is not ready yet, jobs still need it, it has ended already, "
        "or an upload expects other bytes.",
        "`detail` says which. Wait for the jobs that it names, or cancel them. For an upload, ask for its offset and "
        "go on from there.",
    ),
    "idempotency-key-in-use": (
        "The first request with this Idempotency-Key is not finished.",
        "Send the same request again after `Retry-After`. It then gets the answer to the first one.",
    ),
    "gone": (
        "The result has expired or its bytes are lost, what had arrived of an upload is lost, or a link has expired.",
        "For a link, ask for another one. For a result, run the transfer again with a new Idempotency-Key or none; its "
        "video and references must still be there. For an upload, begin again.",
    ),
    "precondition-failed": (
        "The resource is not in the state that `If-Match` names. Or a tus request does not name version 1.0.0.",
        "Get the resource again and send its present `ETag`, or no `If-Match`. With tus, send `Tus-Resumable: 1.0.0`.",
    ),
    "checksum-mismatch": (
        "The bytes do not match `Upload-Checksum`: they were damaged on the way. They were not kept.",
        "Send the same bytes again, from the same `Upload-Offset`.",
    ),
    "url-not-allowed": (
        "The URL of a file or of a webhook's receiver is not http or https, has a port or a password that is not "
        "allowed, or its host is not at a public address.",
        "Use a URL that anybody on the internet can open. For hosts on a network of your own, the operator can add "
        "that network to `PVG_ALLOWED_NETWORKS`.",
    ),
    "fetch-failed": (
        "The file could not be fetched from the URL: its server did not answer, answered with an error, or was too "
        "slow.",
        "Open the URL yourself and correct what `detail` names, or upload the file.",
    ),
    "too-large": (
        "The file or the body has too many bytes (413). Or the file has too many pixels, frames a second or streams, "
        "or a job would need too much memory for it (422).",
        "Send a smaller file. `limit` and `unit` say how much is allowed; /v1/limits lists all limits.",
    ),
    "too-long": (
        "The clip lasts too long or has too many frames.",
        "Cut the clip and upload it again. `limit` and `unit` say how much is allowed; /v1/limits lists all limits.",
    ),
    "unsupported-media-type": (
        "The file is of a format that the service does not read, or is empty. Or the request has a body of another "
        "type than this address takes.",
        "Convert the file to one of the formats in /v1/limits: its first bytes count, not its name. For a body, send "
        "the `Content-Type` that `detail` names.",
    ),
    "range-not-satisfiable": (
        "The requested range lies beyond the end of the file.",
        "Ask for bytes within the length that `Content-Range` of the answer gives.",
    ),
    "misdirected": (
        "The `Host` of the request is not a name of this service.",
        "Use a name that the service knows, or have the operator add this one to `PVG_ALLOWED_HOSTS`.",
    ),
    "header-too-large": (
        "The head of the request has more than 100 lines or 16 KiB. The connection was closed.",
        "Send fewer or shorter header fields.",
    ),
    "validation-failed": (
        "The request is well formed, but a value in it is not allowed, or does not fit the media that it names.",
        "Correct the values that `errors` lists. The same request would fail again.",
    ),
    "idempotency-key-reused": (
        "The Idempotency-Key was used in the last 24 hours for a different request.",
        "Use a new key for each new request.",
    ),
    "no-face": (
        "No face was found in the file, or none for long enough.",
        "Use a file that shows a face clearly, from the front.",
    ),
    "face-too-small": (
        "The largest face in the file is too narrow.",
        "Use a file with a larger face. `upload.face_px` in /v1/limits is the least width in pixels.",
    ),
    "media-invalid": (
        "The file is damaged, or coded in a way that the service does not read.",
        "`detail` says what is wrong. Convert or export the file again, and upload that.",
    ),
    "asset-invalid": (
        "What the service made of the file cannot be read, even after it was made again.",
        "Upload the file again. If that does not help, tell the operator: the disk may be failing.",
    ),
    "source-lost": (
        "The uploaded file is no longer in the storage.",
        "Upload the same file again. Its id stays the same.",
    ),
    "worker-crashed": (
        "The process that worked on the job ended on every attempt.",
        "The file may be the cause: convert it and upload that. Otherwise tell the operator, whose log has the cause.",
    ),
    "time-limit": (
        "The job took longer than a job may take.",
        "Use a shorter or smaller clip, or ask for fewer looks in one job.",
    ),
    "canceled": (
        "The job was canceled, or a medium that it needs was deleted, or the vectorising of that medium was canceled.",
        "If you still want it, upload what is missing again, and repeat the request.",
    ),
    "expired": (
        "No worker took the job in time.",
        "Repeat the request once `/readyz` says that there are workers.",
    ),
    "quota-exceeded": (
        "A limit is used up: the key's rate or one of its quotas, or the number of things that may go on at the same "
        "time. `unit` says of what there was too much, and `limit` how much is allowed.",
        "Wait for `Retry-After`. To make room sooner, cancel jobs, or delete files or unfinished uploads. /v1/usage "
        "shows what is used.",
    ),
    "internal-error": (
        "The service failed; the request or the file need not be wrong.",
        "Try again; if it is a file that has failed (422), upload it again. If it keeps failing, give the operator the "
        "`request_id` or the id of the job: the log has the cause.",
    ),
    "not-implemented": (
        "The body has a `Transfer-Encoding` other than `chunked`.",
        "Send the body as it is or chunked.",
    ),
    "unavailable": (
        "The service cannot do this right now: a part of it does not answer or is too busy, or it is stopping.",
        "Try again after `Retry-After`, with the same Idempotency-Key. If it is a file that has failed (422), upload "
        "it again.",
    ),
    "insufficient-storage": (
        "The disk of the service is too full.",
        "Try again later; the operator has to make room. If it is a file that has failed (422), upload it again then.",
    ),
}
