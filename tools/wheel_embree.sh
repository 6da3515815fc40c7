#!/usr/bin/env bash
# Builds Embree into /usr/local of the image that makes the wheels, for x86-64 and aarch64 alike:
# its releases carry no binaries for Linux on aarch64. Shapes that geraf2 does not use are left out.
set -euo pipefail
version=4.3.3
digest=8a3bc3c3e21aa209d9861a28f8ba93b2f82ed0dc93341dddac09f1f03c36ef2d
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

curl -fsSL --retry 3 -o "$folder/embree.tar.gz" \
    "https://github.com/RenderKit/embree/archive/refs/tags/v$version.tar.gz"
echo "$digest  $folder/embree.tar.gz" | sha256sum --check --quiet
tar -xzf "$folder/embree.tar.gz" -C "$folder"
# The policy: CMake 4 refuses the minimum version that Embree names. Tasks by Embree's own threads,
# so that no wheel carries TBB.
cmake -S "$folder/embree-$version" -B "$folder/build" \
    -DCMAKE_BUILD_TYPE=Release -DCMAKE_POLICY_VERSION_MINIMUM=3.5 \
    -DCMAKE_INSTALL_PREFIX=/usr/local -DCMAKE_INSTALL_LIBDIR=lib \
    -DEMBREE_TASKING_SYSTEM=INTERNAL -DEMBREE_ISPC_SUPPORT=OFF -DEMBREE_TUTORIALS=OFF \
    -DEMBREE_GEOMETRY_CURVE=OFF -DEMBREE_GEOMETRY_GRID=OFF -DEMBREE_GEOMETRY_POINT=OFF \
    -DEMBREE_GEOMETRY_SUBDIVISION=OFF
cmake --build "$folder/build" --parallel "$(nproc)"
cmake --install "$folder/build"
