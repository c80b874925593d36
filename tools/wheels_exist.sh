#!/usr/bin/env bash
# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
# tools/wheels_exist.sh [PYTHON]
#
# Whether everything that setup.py asks for can be installed from wheels on a Raspberry Pi 5 or a
# Jetson: aarch64, Ubuntu 24.04 (Python 3.12), with the NumPy 1 that its ROS 2 Jazzy is compiled
# for. Looks it up and installs nothing.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

mapfile -t wanted < <(sed -n '/install_requires=/,/\]/s/^ *"\(.*\)",$/\1/p' setup.py)
platforms=()
for glibc in 17 24 26 27 28 31 34 35 38 39; do
  platforms+=(--platform "manylinux_2_${glibc}_aarch64")
done
"${1:-python3}" -m pip --disable-pip-version-check install --dry-run --quiet --ignore-installed \
  --target /nowhere --only-binary :all: --python-version 3.12 --implementation cp \
  --platform manylinux2014_aarch64 "${platforms[@]}" "${wanted[@]:?none in setup.py}" 'numpy<2'
echo "there are wheels for aarch64 of: ${wanted[*]}"
