from __future__ import annotations

from datetime import timedelta

from sqlalchemy import update

from service.catalog import Database, Media, Result, Role, results
from tests.service.fixtures import add_media


def test_a_result_is_kept_no_longer_than_its_media(database: Database) -> None:
    video, reference, now = add_media(database), add_media(database, Role.REFERENCE), database.now()
    with database.write() as session:
        for medium, days in ((video, 3), (reference, 2)):
            until = now + timedelta(days=days)
            session.execute(update(Media).where(Media.id == medium.id).values(expires_at=until))
    of_both, of_one, of_none = (
        Result(id=f"res_{k}", video_id=v, reference_id=r, expires_at=now + timedelta(days=7))
        for k, (v, r) in enumerate([(video.id, reference.id), (video.id, "ref_gone"), ("vid_gone", "ref_gone")])
    )
    with database.read() as session:
        kept = results.kept_until(session, [of_both, of_one, of_none])
        # those that were deleted after the results were read
        alone = results.kept_until(session, [of_none])
    days = {result_id: round((until - now) / timedelta(days=1)) for result_id, until in kept.items()}
    assert days == {"res_0": 2, "res_1": 3, "res_2": 7}
    assert alone == {"res_2": of_none.expires_at}
