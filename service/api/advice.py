"""What each kind of problem means and what to do about it: the page at /docs/problems."""

from __future__ import annotations

from typing import Final

#: meaning, and what to do, by the code of the problem
ADVICE: Final[dict[str, tuple[str, str]]] = {
    "malformed": (
        "The request cannot be understood: it is no HTTP, no JSON, no form, or its digest does not fit its bytes.",
        "Mend the request; the detail says what is wrong with it. Sending the same again does not help.",
    ),
    "unauthorized": (
        "The service has keys, and the request names none that is good.",
        "Send `Authorization: Bearer` with a key that `pvg-service keys create` has printed.",
    ),
    "forbidden": (
        "A page of another site wants to write; or a signed link is not as it was made, is of a key that is revoked or "
        "has another secret by now, or is to what belongs to another key by now.",
        "Let the page's origin write by PVG_ALLOWED_ORIGINS, or call from a program. Have another link made.",
    ),
    "not-found": (
        "There is nothing of this id or at this address for this key. What belongs to another key is not found either.",
        "Check the id and the key; what was deleted, or has passed its retention, is not found any more.",
    ),
    "method-not-allowed": (
        "The address is known, and does not take this method.",
        "Use one of the methods in the field Allow of the answer.",
    ),
    "too-slow": (
        "The head of the request, or its body, came more slowly than the service waits for.",
        "Send it again over a better connection. The connection was closed.",
    ),
    "conflict": (
        "The thing is in a state that does not allow this: in use by jobs, or finished already.",
        "Look at its state; wait for the jobs that the detail names, or cancel them.",
    ),
    "idempotency-key-in-use": (
        "The first request with this Idempotency-Key is still being worked on.",
        "Ask again after Retry-After for its answer.",
    ),
    "gone": (
        "The thing was there, and its bytes have been removed after their retention; or the link to it has expired.",
        "Of a link, have another one made. Of a result, run the transfer again, without its Idempotency-Key or with a "
        "new one, with the same video and references if they are there still; of an upload, begin it again.",
    ),
    "precondition-failed": (
        "The thing is not, or no longer, what the request's If-Match names; or the request speaks another version of "
        "tus than 1.0.0, or none where one is needed.",
        "Get the thing again and send its ETag as If-Match, or none; to tus send `Tus-Resumable: 1.0.0`.",
    ),
    "checksum-mismatch": (
        "The bytes are not those of the field Upload-Checksum: they were damaged on the way, and are not kept.",
        "Send the same bytes again, from the same Upload-Offset.",
    ),
    "url-not-allowed": (
        "The URL is no address of the public internet by http or https, or leads to one that is not.",
        "Give a URL that anybody may open; its operator names networks of his own in PVG_ALLOWED_NETWORKS.",
    ),
    "fetch-failed": (
        "The file at the URL could not be had: its server does not answer, answers with an error, or is too slow.",
        "Open the URL yourself; mend what the detail says, or send the file itself.",
    ),
    "too-large": (
        "The file or the body has more bytes than allowed (413); or the file has more pixels, frames a second or "
        "streams than allowed, or needs more memory than a job may take (422).",
        "Send a smaller one. `limit` and `unit` say how much is allowed, and so does /v1/limits.",
    ),
    "too-long": (
        "The clip lasts longer, or has more frames, than the service takes.",
        "Cut it shorter and upload it again. `limit` and `unit` say how much is allowed, and so does /v1/limits.",
    ),
    "unsupported-media-type": (
        "The bytes are not of a kind that the service reads, or the body is of another type than the call takes.",
        "Send one of the formats of /v1/limits; the file's own first bytes count, not its name.",
    ),
    "range-not-satisfiable": (
        "The Range lies outside the file.",
        "Ask for bytes within the length that Content-Range of the answer tells.",
    ),
    "misdirected": (
        "The Host of the request is not a name of this service.",
        "Call it by a name that it knows, or add the name to PVG_ALLOWED_HOSTS.",
    ),
    "header-too-large": (
        "The head of the request has more than 100 lines or 16 KiB.",
        "Send fewer or shorter fields. The connection was closed.",
    ),
    "validation-failed": (
        "The request is well formed, and a value in it is not allowed or does not fit the media it names.",
        "Mend what `errors` points at. Sending the same again does not help.",
    ),
    "idempotency-key-reused": (
        "The Idempotency-Key was used in the last 24 h for a request that was not the same.",
        "Take a new key for a new request.",
    ),
    "no-face": ("No face was found in the file.", "Use a file in which a face can be seen well from the front."),
    "face-too-small": (
        "The largest face is narrower than the service works with.",
        "Use a file in which the face is larger; /v1/limits has the width in pixels.",
    ),
    "media-invalid": (
        "The file is damaged, or not coded in a way that the service reads.",
        "The detail says which; convert the file and upload it again.",
    ),
    "asset-invalid": (
        "What was made of the file cannot be read, though it was made again.",
        "Upload the file again. When that does not help, the service's disk may be failing.",
    ),
    "source-lost": ("The uploaded file is not in the storage any more.", "Upload the same file again; its id stays."),
    "worker-crashed": (
        "The job ended its process on every attempt.",
        "The file may be made to do so. Convert it anew, or tell the operator, whose log has the cause.",
    ),
    "time-limit": ("The job took longer than a job may.", "Use a shorter or smaller file, or fewer looks in a job."),
    "canceled": (
        "The job, or the vectorising of a medium that it needs, was canceled, or its medium was deleted.",
        "Ask for it again if it is wanted, and upload again the file whose vectorising was canceled.",
    ),
    "expired": (
        "No worker took the job in time.",
        "Ask for it again when `/readyz` says that there are workers.",
    ),
    "quota-exceeded": (
        "A quota is used up (requests, unfinished jobs, bytes, open uploads), or as many requests, pictures, streams "
        "or fetched files are at work as may be at a time: `unit` says of what, and `limit` how many.",
        "Wait for Retry-After; end or cancel jobs, or delete files. /v1/usage tells where the key stands.",
    ),
    "internal-error": (
        "Something went wrong on our side.",
        "Try again; a file that has failed so (422), upload again. If it goes on, tell the operator the `request_id` "
        "or the id of the job: the log has the cause.",
    ),
    "not-implemented": ("The body has a transfer coding other than chunked.", "Send the body plain or chunked."),
    "unavailable": (
        "The records or the files cannot be reached right now, or are locked for too long.",
        "Ask again after Retry-After, with the same Idempotency-Key. A file that has failed so (422), upload again.",
    ),
    "insufficient-storage": (
        "The service's disk has no room left for this.",
        "Try again later; the operator has to make room. A file that has failed so (422), upload again then.",
    ),
}
