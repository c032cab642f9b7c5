# A worker that drives a shipped agent, or your own, against a service. Build from the repository's root:
#   docker build -f docker/worker.Dockerfile -t wrongturn-worker .
#   docker run --rm -e WRONGTURN_URL=http://… wrongturn-worker careful
ARG PYTHON_IMAGE=python:3.11-slim-bookworm
FROM ${PYTHON_IMAGE}

ENV PYTHONUNBUFFERED=1 \
    PIP_NO_CACHE_DIR=1 \
    PIP_DISABLE_PIP_VERSION_CHECK=1 \
    PIP_ROOT_USER_ACTION=ignore

WORKDIR /opt/wrongturn

# Install the dependencies before the sources, so that a change of code does not install them again.
COPY LICENSE constraints.txt docker/requirements.py ./
COPY clients/pyproject.toml clients/
COPY agents/pyproject.toml agents/
RUN python requirements.py clients agents[onnx] > requirements.txt \
    && pip install -c constraints.txt -r requirements.txt

COPY clients clients
COPY agents agents
RUN pip install --no-deps ./clients ./agents \
    && rm -rf clients agents

# A run notes in its home how to resume it. In /agents, compose's 'register' writes into the homes of its workers: a new
# volume takes over the owner of the image's folder.
RUN useradd --system --uid 10001 --home-dir /var/lib/wrongturn --shell /usr/sbin/nologin wrongturn \
    && install -d -o wrongturn -g wrongturn -m 0750 /var/lib/wrongturn \
    && for agent in $(python -c 'from wrongturn_agents.registry import list_agents; print(*[a.name for a in list_agents()])'); do \
        install -d -o wrongturn -g wrongturn -m 0750 "/agents/$agent"; \
    done
ENV WRONGTURN_HOME=/var/lib/wrongturn \
    WRONGTURN_SUITE=wrong-command@3
USER wrongturn
WORKDIR /var/lib/wrongturn
VOLUME /var/lib/wrongturn

# A worker is healthy while it runs. If it cannot reach the service, it says so and tries again.
HEALTHCHECK NONE
ENTRYPOINT ["sh", "-c", "exec wrongturn run --suite \"$WRONGTURN_SUITE\" --progress lines \"$@\"", "worker"]
CMD ["careful"]
