# One image for every service. The base is an argument: where no image registry is reached,
# deploy/base-image makes one that stands in (BASE_IMAGE=wyner-base:local).
ARG BASE_IMAGE=python:3.12-slim

FROM ${BASE_IMAGE} AS build
WORKDIR /build
RUN python3 -m venv /opt/wyner
# Dependencies first: they change seldom, and their layer is kept while they do not.
COPY requirements/runtime.txt requirements/runtime.txt
RUN /opt/wyner/bin/python -m pip install --no-cache-dir --disable-pip-version-check --no-compile \
        --only-binary :all: --require-hashes --requirement requirements/runtime.txt
COPY pyproject.toml LICENSE NOTICE README.md ./
COPY protocol protocol
COPY runtime runtime
COPY controller_service controller_service
COPY plant_service plant_service
COPY tap_service tap_service
COPY attacker_service attacker_service
COPY wyner wyner
# setuptools came in with its hash above, so nothing is fetched here. What only builds or tests
# (pip, the libraries' own test folders) stays out of the image.
RUN /opt/wyner/bin/python -m pip install --no-cache-dir --disable-pip-version-check \
        --no-compile --no-deps --no-build-isolation --no-index . \
    && /opt/wyner/bin/python -m pip uninstall --yes --quiet pip \
    && find /opt/wyner/lib -type d \( -name tests -o -name __pycache__ \) -prune -exec rm -rf {} + \
    && /opt/wyner/bin/python -m compileall -qf --invalidation-mode unchecked-hash /opt/wyner/lib \
    && /opt/wyner/bin/wyner --version

FROM ${BASE_IMAGE}
ARG VERSION=1.0.0
LABEL org.opencontainers.image.title=wyner \
      org.opencontainers.image.version=${VERSION} \
      org.opencontainers.image.licenses="Apache-2.0 AND CC-BY-SA-4.0"
# A fixed number, so that what a volume holds keeps its owner from one image to the next. The
# folders are made here because a new volume takes its owner from the folder it covers.
RUN echo 'wyner:x:10001:10001::/nonexistent:/usr/sbin/nologin' >> /etc/passwd \
    && echo 'wyner:x:10001:' >> /etc/group \
    && install -d -o 10001 -g 10001 -m 700 /var/lib/wyner /var/lib/wyner/run \
        /var/lib/wyner/knowledge /var/lib/wyner/certs \
    && for name in router controller plant tap; do \
        install -d -o 10001 -g 10001 -m 700 /var/lib/wyner/certs/$name; done
COPY --from=build /opt/wyner /opt/wyner
COPY deploy/healthy /usr/local/bin/
ENV PATH=/opt/wyner/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    XDG_CACHE_HOME=/var/lib/wyner/run/cache
USER wyner
WORKDIR /var/lib/wyner
STOPSIGNAL SIGTERM
ENTRYPOINT ["wyner"]
CMD ["--help"]
