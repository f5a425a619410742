# One image for the API and the worker; the commands are those of the Makefile.
#
# Its kernels are compiled here, once, for a processor that every host of today has, and not for the one that happens to
# build the image: their cache then serves each of them. An older x86 processor needs NUMBA_CPU_NAME=x86-64 at run time
# and a writable PVG_CACHE_DIR. Nothing under /app is written at run time, so that the file system may be read-only and
# the user any number; only /data must be writable (docs/decisions/0013).
#
# What is distributed as an image holds PyAV's FFmpeg with x264 and x265, which are GPL: see NOTICE.
ARG TARGETARCH=amd64

FROM python:3.11-slim AS for-amd64
ENV NUMBA_CPU_NAME=x86-64-v3 NUMBA_CPU_FEATURES=""

FROM python:3.11-slim AS for-arm64
ENV NUMBA_CPU_NAME=generic NUMBA_CPU_FEATURES=""

FROM for-${TARGETARCH}
WORKDIR /app
ENV PATH=/app/.venv/bin:$PATH PYTHONUNBUFFERED=1 PVG_DATA_DIR=/data PVG_CACHE_DIR=/app/cache ORT_DISABLE_TELEMETRY=1

COPY constraints.txt ./
COPY pyproject.toml README.md LICENSE NOTICE pvg_service.py ./source/
COPY pvg ./source/pvg
COPY service ./source/service
COPY worker ./source/worker
# root owns it all, and the service needs no root: neither its files nor its port
RUN python -m venv .venv \
    && python -m pip install --no-cache-dir --disable-pip-version-check -c constraints.txt './source[service,postgres]' \
    && rm -r source \
    && pvg models \
    && python -m pvg.warmup \
    && install -d -o 10001 -g 10001 /data
USER 10001:10001

VOLUME /data
EXPOSE 8000
CMD ["pvg-service", "serve"]
