# Two images from one file: `api` has the service's own dependencies (no decoder, no network weights), `worker`, the
# last, has everything and does every command. docs/operations/deployment.md says how they are run.
#
#     docker build --target api -t pvg-api .
#     docker build -t pvg-worker .
#
# The base is a tag until it is pinned: --build-arg PYTHON_IMAGE=python:3.11-slim@sha256:… (the same page says how the
# digest is found). What is installed on it is locked by hash, for every platform, in requirements/.
#
# The worker's kernels are compiled here, once, for a processor that every host of today has, and not for the one that
# happens to build the image: their cache then serves each of them. An older x86 processor needs NUMBA_CPU_NAME=x86-64
# and NUMBA_CACHE_DIR=/data/kernels at run time (docs/decisions/0013).
#
# Nothing under /app is written at run time, so the file system may be read-only, with a tmpfs at /tmp; only /data must
# be writable. The user is a number of group 0: any other number of that group does as well.
#
# What is distributed as an image of the worker holds PyAV's FFmpeg with x264 and x265, which are GPL: see NOTICE.
ARG PYTHON_IMAGE=python:3.11-slim
# TARGETARCH is BuildKit's own: a default here would take its place on every platform

FROM ${PYTHON_IMAGE} AS base
WORKDIR /app
ENV PATH=/app/.venv/bin:$PATH PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1 HOME=/tmp PVG_DATA_DIR=/data/pvg
# the service makes its own folder in it, which only its user may enter
RUN install -d -m 770 -o 10001 -g 0 /data
VOLUME /data
EXPOSE 8000

FROM base AS build
RUN python -m venv .venv
COPY requirements/api.txt requirements/service.txt ./
COPY pyproject.toml README.md LICENSE NOTICE pvg_service.py ./source/
COPY pvg ./source/pvg
COPY service ./source/service
COPY worker ./source/worker

FROM build AS build-api
RUN python -m pip install --no-cache-dir --disable-pip-version-check --require-hashes -r api.txt \
    && python -m pip install --no-cache-dir --disable-pip-version-check --no-deps --no-build-isolation ./source

FROM build AS worker-for-amd64
ENV NUMBA_CPU_NAME=x86-64-v3 NUMBA_CPU_FEATURES=""

FROM build AS worker-for-arm64
ENV NUMBA_CPU_NAME=generic NUMBA_CPU_FEATURES=""

# hadolint ignore=DL3006
FROM worker-for-${TARGETARCH} AS build-worker
ENV PVG_CACHE_DIR=/app/cache ORT_DISABLE_TELEMETRY=1
RUN python -m pip install --no-cache-dir --disable-pip-version-check --require-hashes -r service.txt \
    && python -m pip install --no-cache-dir --disable-pip-version-check --no-deps --no-build-isolation ./source \
    && pvg models \
    && python -m pvg.warmup

FROM base AS api
COPY --from=build-api /app/.venv /app/.venv
USER 10001:0
CMD ["pvg-service", "serve", "--no-worker"]

FROM base AS runs-on-amd64
ENV NUMBA_CPU_NAME=x86-64-v3 NUMBA_CPU_FEATURES=""

FROM base AS runs-on-arm64
ENV NUMBA_CPU_NAME=generic NUMBA_CPU_FEATURES=""

# hadolint ignore=DL3006
FROM runs-on-${TARGETARCH} AS worker
ENV PVG_CACHE_DIR=/app/cache ORT_DISABLE_TELEMETRY=1
COPY --from=build-worker /app/.venv /app/.venv
COPY --from=build-worker /app/cache /app/cache
USER 10001:0
CMD ["pvg-service", "serve"]
