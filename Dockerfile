# The service in a container:
#   docker build -t rosaline .
#   docker run --rm -v rosaline:/var/lib/rosaline rosaline keys add NAME --scope submit,read
#   docker run --rm -p 8080:8080 -v rosaline:/var/lib/rosaline rosaline

FROM rust:1.95-slim-trixie AS build
RUN apt-get update && apt-get install --yes --no-install-recommends build-essential && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY Cargo.toml Cargo.lock ./
COPY src src
COPY benches benches
RUN --mount=type=cache,target=/usr/local/cargo/registry --mount=type=cache,target=/source/target \
    cargo build --release --locked --bin rosaline && strip --strip-debug -o /rosaline target/release/rosaline

FROM debian:trixie-slim
# Whom requests go to that the service sends itself: webhooks, and an issuer's keys.
RUN apt-get update && apt-get install --yes --no-install-recommends ca-certificates && rm -rf /var/lib/apt/lists/*
RUN useradd --system --uid 10001 --no-create-home --shell /usr/sbin/nologin rosaline \
    && install --directory --owner=rosaline --group=rosaline --mode=0700 /var/lib/rosaline
COPY --from=build /rosaline /usr/local/bin/rosaline
USER 10001
# Without a key (or an issuer, or ROSALINE_INSECURE=true) it does not start. For TLS mount a certificate and its key, and name them in
# ROSALINE_TLS_CERT and ROSALINE_TLS_KEY: the health check follows. Reachable from outside of the container, which publishes the port or does not. Docker waits 10 s between
# SIGTERM and SIGKILL: the grace time, and up to 2 s for jobs that it interrupts; raise both for long jobs.
ENV ROSALINE_LISTEN=0.0.0.0:8080 \
    ROSALINE_DATA=/var/lib/rosaline \
    ROSALINE_GRACE=6s \
    ROSALINE_LOG_FORMAT=json
VOLUME /var/lib/rosaline
EXPOSE 8080
# Whether it is alive: whatever restarts what is unhealthy must not end running jobs for a full disk. `rosaline health` without --alive
# says whether requests should be sent.
HEALTHCHECK --interval=10s --timeout=6s --start-period=30s CMD ["rosaline", "health", "--alive"]
ENTRYPOINT ["rosaline"]
CMD ["serve"]
