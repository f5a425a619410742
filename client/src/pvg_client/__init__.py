"""A client of the face colour transfer service, blocking (`Client`) and for asyncio (`AsyncClient`).

with Client("http://127.0.0.1:8000") as client:
    video = client.upload("clip.mp4")
    reference = client.upload("portrait.jpg", role="reference")
    job = client.wait(client.transfer(video, [Look(reference)]))
    client.download(job.results[0], "look.mp4")
"""

from pvg_client._version import __version__
from pvg_client.client import AsyncClient, Client
from pvg_client.errors import ApiError, DamagedError, JobFailed, PvgClientError, UnreachableError, WebhookError
from pvg_client.models import (
    Eta,
    Extra,
    Face,
    FieldError,
    Job,
    JobLook,
    Limits,
    Link,
    Look,
    Medium,
    Month,
    Picture,
    Problem,
    Progress,
    Result,
    Upload,
    UploadLink,
    Usage,
    Used,
    Webhook,
    WebhookSecret,
)
from pvg_client.webhooks import verify_webhook

__all__ = [
    "ApiError",
    "AsyncClient",
    "Client",
    "DamagedError",
    "Eta",
    "Extra",
    "Face",
    "FieldError",
    "Job",
    "JobFailed",
    "JobLook",
    "Limits",
    "Link",
    "Look",
    "Medium",
    "Month",
    "Picture",
    "Problem",
    "Progress",
    "PvgClientError",
    "Result",
    "UnreachableError",
    "Upload",
    "UploadLink",
    "Usage",
    "Used",
    "Webhook",
    "WebhookError",
    "WebhookSecret",
    "__version__",
    "verify_webhook",
]
