from __future__ import annotations

import json

import pytest

from service.catalog import (
    Database,
    JobKind,
    LookParams,
    NewLook,
    OutputOptions,
    RenderRequest,
    Role,
    VectorizeRequest,
    VectorSettings,
    jobs,
    look_params,
    render_request,
    vectorize_request,
)
from service.catalog.models import Job, Look
from tests.service.fixtures import add_media, job_of

LOOK = LookParams(strength=0.5, contrast=1.1, match="color", protect=("eyes",), faces=(0, 2))
SWAPPED = LookParams(contrast=(0.8, "auto"), faces=(1, 0), beta=0.5, iterations=3, seed=7, exchange=True)
OF_A_GROUP = LookParams(reference_face=2, makeup={"lips": 1.0, "brows": 0.0}, light=0.5)
PAPERS = VectorSettings(mask="ycbcr", matching="chain")
OUTPUT = OutputOptions(container="webm", codec="vp9", crf=30, preset="fast", audio="none")
WITH_EXTRAS = OutputOptions(extras=("cube", "matte"), matte="prores")


def test_a_request_comes_back_from_the_record_as_it_was(database: Database) -> None:
    video = add_media(database, Role.VIDEO, settings=PAPERS)
    with database.write() as session:
        looks = [NewLook(video.id, video.id, params) for params in (LOOK, LookParams(), SWAPPED, OF_A_GROUP)]
        made = jobs.create(session, JobKind.TRANSFER, request=RenderRequest(OUTPUT), now=database.now(), outputs=looks)
    with database.read() as session:
        job, vectorizing = jobs.get(session, made.id), jobs.get(session, video.job_id)
        stored = jobs.looks(session, made.id)
    assert job is not None
    assert vectorizing is not None
    assert render_request(job) == RenderRequest(OUTPUT)
    assert [look_params(look) for look in stored] == [LOOK, LookParams(), SWAPPED, OF_A_GROUP]
    with database.write() as session:
        other = jobs.create(session, JobKind.TRANSFER, request=RenderRequest(WITH_EXTRAS), now=database.now())
    stored_other = job_of(database, other.id)
    assert render_request(stored_other) == RenderRequest(WITH_EXTRAS)
    assert vectorize_request(vectorizing) == VectorizeRequest(Role.VIDEO, PAPERS)


#: what the first version wrote into its columns
FORMER_LOOK = '{"strength": 0.5, "contrast": 1.1, "match": "color", "protect": ["eyes"], "faces": [0, 2]}'
FORMER_RENDER = '{"output": {"container": "webm", "codec": "vp9", "crf": 30, "preset": "fast", "audio": "none"}}'
FORMER_DEFAULTS = '{"output": {"container": null, "codec": "auto", "crf": null, "preset": null, "audio": "copy"}}'


def test_jobs_of_the_former_version_are_read() -> None:
    assert look_params(Look(params=json.loads(FORMER_LOOK))) == LOOK
    assert look_params(Look(params=json.loads(FORMER_LOOK.replace("[0, 2]", '"all"')))).faces == "all"
    assert render_request(Job(request=json.loads(FORMER_RENDER))) == RenderRequest(OUTPUT)
    assert render_request(Job(request=json.loads(FORMER_DEFAULTS))) == RenderRequest()
    assert vectorize_request(Job(request={"role": "reference"})) == VectorizeRequest(Role.REFERENCE)


def test_a_value_that_was_not_recorded_is_its_default_and_an_unknown_one_is_passed_over() -> None:
    assert look_params(Look(params={"strength": 0.2, "glitter": 1})) == LookParams(strength=0.2)
    assert render_request(Job(request={})) == RenderRequest()


def test_a_job_of_another_kind_is_not_taken_for_a_vectorisation() -> None:
    with pytest.raises(KeyError):
        vectorize_request(Job(request=json.loads(FORMER_RENDER)))
