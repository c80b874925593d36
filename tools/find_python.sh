#!/usr/bin/env bash
# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
# tools/find_python.sh VERSION...
#
# Prints the path of a Python of one of the versions that can make virtual environments and, when
# MODULE is set, import it. Says what was tried when there is none. PYTHON allows only that one.
set -euo pipefail

if [ -n "${PYTHON:-}" ]; then
  candidates=("$PYTHON")
else
  candidates=(python3 "${@/#/python}")
  for version in "$@"; do
    candidates+=("${PYENV_ROOT:-$HOME/.pyenv}/versions/$version".*/bin/python3)
  done
  candidates+=(/usr/bin/python3)
fi

tried=''
lacks_venv=''
for candidate in "${candidates[@]}"; do
  if ! path=$(command -v "$candidate"); then
    [ -z "${PYTHON:-}" ] || tried+="  $candidate: not found"$'\n'
    continue
  fi
  # What exists need not run (a pyenv shim), so it is the answer that counts.
  if ! version=$("$path" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null); then
    tried+="  $path: does not run"$'\n'
  elif [[ " $* " != *" $version "* ]]; then
    tried+="  $path: is Python $version"$'\n'
  elif ! "$path" -c 'import ensurepip, venv' 2>/dev/null; then
    tried+="  $path: is Python $version without venv"$'\n'
    lacks_venv=${lacks_venv:-$version}
  elif [ -n "${MODULE:-}" ] && ! error=$("$path" -c "import $MODULE" 2>&1); then
    tried+="  $path: cannot import $MODULE (${error##*$'\n'})"$'\n'
  else
    echo "$path"
    exit
  fi
done

{
  versions=$*
  echo "No usable Python found: ${versions// / or } with venv is needed. Tried:"
  printf '%s' "${tried:-  nothing: there is no python3}"
  if [ -n "$lacks_venv" ]; then
    echo "On Debian and Ubuntu: sudo apt install python$lacks_venv-venv"
  elif [ -z "${MODULE:-}" ]; then
    echo "On Debian 12 and Ubuntu 24.04: sudo apt install python3 python3-venv"
    echo "Another one can be named: make run PYTHON=/path/to/python3"
  fi
} >&2
exit 1
