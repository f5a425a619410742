# One image for the API and the worker; the commands are those of the Makefile.
FROM python:3.11-slim

# the service needs no root: neither its files nor its port
RUN useradd --create-home --uid 10001 pvg \
    && install -d -o pvg -g pvg /app /data
USER pvg
WORKDIR /app
ENV PATH=/app/.venv/bin:$PATH PYTHONUNBUFFERED=1 PVG_DATA_DIR=/data

COPY --chown=pvg:pvg constraints.txt pyproject.toml README.md LICENSE NOTICE ./
COPY --chown=pvg:pvg pvg ./pvg
COPY --chown=pvg:pvg service ./service
COPY --chown=pvg:pvg worker ./worker
RUN python -m venv .venv \
    && python -m pip install --no-cache-dir --disable-pip-version-check -c constraints.txt setuptools wheel \
    && python -m pip install --no-cache-dir --disable-pip-version-check -c constraints.txt . \
    && python -m pvg.models \
    && python -m pvg.warmup

VOLUME /data
EXPOSE 8000
CMD ["pvg-service", "serve"]
