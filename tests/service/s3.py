"""An S3 server for tests: moto's, as a process of its own.

It does multipart uploads, ranges, listings and signed addresses as S3 does. It cannot be told to hang, and does not
look at how old a signed address is; see `tests.service.object_store` for one that misbehaves.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from typing import Any

import httpx

from tests.service.servers import free_port, stop

REGION = "us-east-1"
#: keys in a page of a listing; S3 has 1000
PAGE = 50
#: what a signature is checked by, once it is checked
_MAY_DO_ALL = '{"Version": "2012-10-17", "Statement": [{"Effect": "Allow", "Action": "s3:*", "Resource": "*"}]}'


@dataclass(frozen=True)
class S3:
    """The server, one bucket of it, and a key to it."""

    url: str
    bucket: str = ""
    key_id: str = "key"
    secret: str = field(default="secret", repr=False)

    @property
    def storage_url(self) -> str:
        """The bucket as `PVG_STORAGE_URL` names it, with a prefix."""
        return f"s3://{self.bucket}/faces"

    def environment(self) -> dict[str, str]:
        """The credentials and the address, as `AWS_*` variables."""
        keys = {"AWS_ACCESS_KEY_ID": self.key_id, "AWS_SECRET_ACCESS_KEY": self.secret, "AWS_REGION": REGION}
        return keys | {"AWS_ENDPOINT": self.url, "AWS_ALLOW_HTTP": "true"}

    def client(self, service: str = "s3") -> Any:
        """AWS's own client of it, to look at what is there without the service's code."""
        import boto3  # takes long

        return boto3.client(
            service,
            endpoint_url=self.url,
            region_name=REGION,
            aws_access_key_id=self.key_id,
            aws_secret_access_key=self.secret,
        )

    def sizes(self) -> dict[str, int]:
        """The size of everything in the bucket, by its key."""
        pages = self.client().get_paginator("list_objects_v2").paginate(Bucket=self.bucket)
        return {entry["Key"]: entry["Size"] for page in pages for entry in page.get("Contents", [])}

    def listed(self) -> list[str]:
        """The keys of everything in the bucket."""
        return list(self.sizes())

    def read(self, key: str) -> bytes:
        """What is stored under a key."""
        body: bytes = self.client().get_object(Bucket=self.bucket, Key=key)["Body"].read()
        return body

    def contents(self) -> list[bytes]:
        """Everything in the bucket."""
        client, found = self.client(), []
        for key in self.listed():
            with suppress(client.exceptions.NoSuchKey):  # deleted since it was listed
                found.append(client.get_object(Bucket=self.bucket, Key=key)["Body"].read())
        return found

    @contextmanager
    def fresh_bucket(self) -> Iterator[S3]:
        """The same server with an empty bucket, which is emptied again afterwards."""
        one = replace(self, bucket=f"pvg-test-{uuid.uuid4().hex[:12]}")
        client = self.client()
        client.create_bucket(Bucket=one.bucket)
        try:
            yield one
        finally:
            while keys := [{"Key": key} for key in one.listed()[:1000]]:
                client.delete_objects(Bucket=one.bucket, Delete={"Objects": keys})
            client.delete_bucket(Bucket=one.bucket)

    @contextmanager
    def checking_signatures(self) -> Iterator[S3]:
        """For a while only requests signed by this key are answered; signed addresses are not understood then."""
        users, name = self.client("iam"), f"user-{uuid.uuid4().hex[:8]}"
        users.create_user(UserName=name)
        users.put_user_policy(UserName=name, PolicyName="all", PolicyDocument=_MAY_DO_ALL)
        key = users.create_access_key(UserName=name)["AccessKey"]
        self._check_from("0")
        try:
            yield replace(self, key_id=key["AccessKeyId"], secret=key["SecretAccessKey"])
        finally:
            self._check_from("inf")

    def _check_from(self, request: str) -> None:
        httpx.post(f"{self.url}/moto-api/reset-auth", content=request.encode(), timeout=60).raise_for_status()


@contextmanager
def s3_server() -> Iterator[S3]:
    """A server of our own at a free port."""
    port = free_port()
    # what is said of real accounts on this machine is none of its business
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("AWS_", "MOTO_"))}
    environment["MOTO_S3_DEFAULT_MAX_KEYS"] = str(PAGE)
    process = subprocess.Popen(
        [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    server = S3(f"http://127.0.0.1:{port}")
    try:
        until = time.monotonic() + 180
        while True:
            assert process.poll() is None, "moto's server ended by itself"
            with suppress(httpx.TransportError):
                httpx.get(f"{server.url}/moto-api/", timeout=60).raise_for_status()
                break
            assert time.monotonic() < until, "moto's server does not answer"
            time.sleep(0.05)
        yield server
    finally:
        stop(process)
