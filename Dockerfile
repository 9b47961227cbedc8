# The service with its page, on the CPU. Build: docker build -t drape . Run for this machine alone:
# docker run -p 127.0.0.1:8000:8000 -e DRAPE_OPEN=true drape; for others mount a file of keys and name it in DRAPE_KEYS_FILE.
# For a GPU: docker build --build-arg EXTRA=gpu -t drape-gpu . and run it with --gpus all -e DRAPE_PROVIDER=cuda.

# The engine for browsers.
FROM python:3.12-slim AS wasm
WORKDIR /app
COPY drape/engine drape/engine
RUN DRAPE_CACHE=/tmp/cache python drape/engine/build.py --wasm

FROM node:22-slim AS page
WORKDIR /app/clients/web
COPY clients/web/package.json clients/web/package-lock.json ./
RUN npm ci --no-audit --no-fund
COPY clients/web ./
COPY --from=wasm /app/drape/engine/libraries /app/drape/engine/libraries
RUN npm run build

# For every processor of this system, so that no container compiles.
FROM python:3.12-slim AS engine
WORKDIR /app
COPY drape/engine drape/engine
RUN DRAPE_CACHE=/tmp/cache python drape/engine/build.py --system

FROM python:3.12-slim
# Which ONNX Runtime: cpu or gpu, never both.
ARG EXTRA=cpu
ENV DRAPE_ENGINE=apart PYTHONDONTWRITEBYTECODE=1 PYTHONUNBUFFERED=1 PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1
WORKDIR /app
COPY pyproject.toml hatch_build.py README.md LICENSE ./
COPY drape drape
COPY service service
COPY clients clients
# Editable, so that the code finds the page and writes into runs/, as in a clone.
RUN pip install -e ".[${EXTRA}]" -e "service[otel]"
# The promise that the service runs without torch is kept here, not only in the tests.
RUN python -c "import importlib.util as u, sys; sys.exit('torch is in the image' if u.find_spec('torch') else 0)"
COPY --from=page /app/clients/web/dist clients/web/dist
COPY --from=engine /app/drape/engine/libraries drape/engine/libraries
RUN useradd --create-home --uid 10001 drape && mkdir -p .cache runs && chown drape .cache runs
USER drape
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=3s --start-period=30s --retries=3 \
    CMD ["python", "-c", "import urllib.request as r; r.urlopen('http://127.0.0.1:8000/livez', timeout=2)"]
CMD ["python", "-m", "service", "--host", "0.0.0.0", "--port", "8000"]
