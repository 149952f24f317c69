# One image for every service: the `tangent` program, the cell and task files, the scenarios. At run
# time it needs no shell, no compiler and no root. `docker compose build` builds the image. See
# docs/deploy.md.

# A tag can refer to another image later. For a build that can be repeated in years, use digests:
# `docker buildx imagetools inspect rust:1.95-bookworm` prints them, and
# `--build-arg BUILD_IMAGE=rust@sha256:… --build-arg RUN_IMAGE=debian@sha256:…` uses them.
ARG BUILD_IMAGE=rust:1.95-bookworm
ARG RUN_IMAGE=debian:12-slim

FROM ${BUILD_IMAGE} AS build
WORKDIR /build
COPY . .
# Without debug information the program has a tenth of the size.
ENV CARGO_PROFILE_RELEASE_DEBUG=false CARGO_PROFILE_RELEASE_STRIP=symbols
RUN cargo build --release --locked --bin tangent

FROM ${RUN_IMAGE}
COPY --from=build /build/target/release/tangent /usr/local/bin/tangent
COPY deploy /tangent/deploy
COPY scenarios /tangent/scenarios
# A new named volume that is mounted here gets this owner.
RUN install -d -o 10001 -g 10001 /tangent/recordings /tangent/state
WORKDIR /tangent
USER 10001:10001
EXPOSE 7447
ENTRYPOINT ["/usr/local/bin/tangent"]
CMD ["--help"]
