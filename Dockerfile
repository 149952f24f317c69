# One image for every service: the `tangent` program, the cell and task files, the scenarios. No shell, no compiler, no root is
# needed at run time. `docker compose build` makes it; docs/deploy.md says how to use it.

# Tags move. What is to be built again in years is built from digests: `docker buildx imagetools inspect rust:1.95-bookworm` says them, and
# `--build-arg BUILD_IMAGE=rust@sha256:… --build-arg RUN_IMAGE=debian@sha256:…` takes them.
ARG BUILD_IMAGE=rust:1.95-bookworm
ARG RUN_IMAGE=debian:12-slim

FROM ${BUILD_IMAGE} AS build
WORKDIR /build
COPY . .
# Without the debug tables the program is a tenth of the size.
ENV CARGO_PROFILE_RELEASE_DEBUG=false CARGO_PROFILE_RELEASE_STRIP=symbols
RUN cargo build --release --locked --bin tangent

FROM ${RUN_IMAGE}
COPY --from=build /build/target/release/tangent /usr/local/bin/tangent
COPY deploy /tangent/deploy
COPY scenarios /tangent/scenarios
# A named volume that is mounted here for the first time takes over this owner.
RUN install -d -o 10001 -g 10001 /tangent/recordings /tangent/state
WORKDIR /tangent
USER 10001:10001
EXPOSE 7447
ENTRYPOINT ["/usr/local/bin/tangent"]
CMD ["--help"]
