# The service with its simulators. Build from the repository's root:
#   docker build -f docker/service.Dockerfile -t wrongturn-service .
# With Ray, for simulators on other machines (docs/compose.md):
#   docker build -f docker/service.Dockerfile --build-arg PLUGIN=ray -t wrongturn-service-ray .
ARG PYTHON_IMAGE=python:3.11-slim-bookworm
FROM ${PYTHON_IMAGE}

# libsumo is linked to SUMO's window libraries, although it never opens a window. The sandboxes need libseccomp.
# 'wrongturn backup' and 'restore' run pg_dump and pg_restore, which are of the version of compose's database.
RUN apt-get update \
    && apt-get install -y --no-install-recommends \
        libx11-6 libxext6 libxrender1 libgl1 libatomic1 libseccomp2 postgresql-client-15 \
    && rm -rf /var/lib/apt/lists/*

ENV PYTHONUNBUFFERED=1 \
    PIP_NO_CACHE_DIR=1 \
    PIP_DISABLE_PIP_VERSION_CHECK=1 \
    PIP_ROOT_USER_ACTION=ignore

WORKDIR /opt/wrongturn

# Install the dependencies before the sources, so that a change of code does not install them again. Delete the tests
# that some packages contain: they would be an eighth of the image. Of SUMO's programs keep netconvert, which builds
# towns; it has the same libraries as libsumo.
COPY LICENSE constraints.txt docker/requirements.py ./
COPY clients/pyproject.toml clients/
COPY networks/pyproject.toml networks/
COPY service/pyproject.toml service/
COPY plugins/ray/pyproject.toml plugins/ray/
ARG PLUGIN=
RUN python requirements.py clients networks "service[server]" ${PLUGIN:+"plugins/$PLUGIN"} > requirements.txt \
    && pip install -c constraints.txt -r requirements.txt \
    && cd "$(python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')" \
    && find . -type d -name tests -prune -exec rm -rf {} + \
    && find sumo/bin -type f ! -name netconvert -delete \
    && rm -rf sumo/data sumo/lib64 sumo/tools sumo_data eclipse_sumo.libs \
    && ln -s libsumo.libs eclipse_sumo.libs \
    && sumo/bin/netconvert --version

COPY clients clients
COPY networks networks
COPY service service
COPY plugins/ray plugins/ray
RUN pip install --no-deps ./clients ./networks ./service ${PLUGIN:+"./plugins/$PLUGIN"} \
    && rm -rf clients networks service plugins

# Compile here, because it takes minutes on a busy machine. A running container only reads these files. It copies them to
# its volume and adds what another processor needs there.
ENV WRONGTURN_KERNELS=/opt/wrongturn/kernels
RUN NUMBA_CACHE_DIR="$WRONGTURN_KERNELS" WRONGTURN_HOME=/tmp/home python -m wrongturn_sim \
    && rm -rf /tmp/home \
    && chmod -R a=rX,u+w "$WRONGTURN_KERNELS"

# The service writes (database, caches, models) into one folder, which compose puts on a volume. The sandboxes of models
# have a user of their own. The two meet in a folder with a socket, by a group that both are in.
RUN groupadd --system --gid 10003 runner \
    && useradd --system --uid 10002 --gid runner --no-create-home --shell /usr/sbin/nologin sandbox \
    && useradd --system --uid 10001 --groups runner --home-dir /var/lib/wrongturn --shell /usr/sbin/nologin wrongturn \
    && install -d -o wrongturn -g wrongturn -m 0750 /var/lib/wrongturn \
    && install -d -o sandbox -g runner -m 2750 /run/wrongturn
# Allow more time than the service's default, for a processor that the kernels above do not fit. Each submission takes
# two of the runner's sandboxes, and the checks of other models two more.
ENV WRONGTURN_HOST=0.0.0.0 \
    WRONGTURN_PORT=8000 \
    WRONGTURN_HOME=/var/lib/wrongturn \
    WRONGTURN_SIMULATOR_START_TIMEOUT_S=300 \
    WRONGTURN_SUBMISSIONS=2
USER wrongturn
WORKDIR /var/lib/wrongturn
VOLUME /var/lib/wrongturn
EXPOSE 8000

HEALTHCHECK --interval=10s --timeout=5s --start-period=300s --retries=3 \
    CMD ["python", "-c", "import urllib.request; urllib.request.urlopen('http://127.0.0.1:8000/health/ready', timeout=4)"]

CMD ["wrongturn", "serve"]
