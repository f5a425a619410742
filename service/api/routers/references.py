"""/references: a picture or clip whose skin colours are to be used."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from service.api import commands
from service.api.dependencies import CancelJobs, Cursor, MaskOf, PageSize, ReferenceId, ServicesDep, answer, problems
from service.api.openapi import file_body
from service.api.routers import _media
from service.api.schemas import MediaBody, MediaPage, ReferenceOptions
from service.catalog import Role

router = APIRouter(prefix="/references", tags=["references"])


@router.post(
    "",
    status_code=202,
    responses=answer(200, MediaBody, "the same content is there already") | problems(400, 413, 415, 507),
    openapi_extra=file_body("A picture or clip whose skin colours are to be used", ReferenceOptions),
)
async def upload_reference(
    request: Request, response: Response, services: ServicesDep, mask: MaskOf = None
) -> MediaBody:
    """Upload a reference; it is vectorised once, and the same bytes with the same mask answer with the same id."""
    given = _media.Given(ReferenceOptions, {"mask": mask})
    return await _media.upload(services, Role.REFERENCE, request, response, given)


@router.get("", responses=problems())
def list_references(services: ServicesDep, cursor: Cursor = None, limit: PageSize = 50) -> MediaPage:
    """All references, newest first."""
    return _media.page(services, Role.REFERENCE, cursor, limit)


@router.get("/{reference_id}", responses=problems(404))
def show_reference(reference_id: ReferenceId, services: ServicesDep) -> MediaBody:
    """One reference: its state, and what was found in it once it is ready."""
    return _media.show(services, Role.REFERENCE, reference_id)


@router.delete("/{reference_id}", status_code=204, responses=problems(404, 409, 507))
def delete_reference(reference_id: ReferenceId, services: ServicesDep, cancel_jobs: CancelJobs = False) -> None:
    """Delete the reference with everything derived from it: landmarks, asset and results."""
    commands.remove(services, Role.REFERENCE, reference_id, cancel_jobs=cancel_jobs)
