#!/usr/bin/env bash
# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
# tools/in_venv.sh EXTRA[,EXTRA...] COMMAND...
#
# Runs COMMAND where quad_mpc_ros and the given extras of setup.py are installed: in the virtual
# environment VENV (.venv), which is made from PYTHON, or brought up to date, when it has to be.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

venv=${VENV:-.venv}
[[ $venv = /* ]] || venv=$PWD/$venv
state=$venv/.state
log=$state/pip.log
copy=$state/source
IFS=, read -ra extras <<<"$1"
shift

# Which ROS 2 is sourced. Containers set ROS_DISTRO without sourcing anything.
sourced=${AMENT_PREFIX_PATH:+${ROS_DISTRO:-}}
if [[ $sourced =~ ^(jazzy|kilted)$ ]] && [ "${extras[0]}" = ros ]; then
  extras=("${extras[@]:1}")
fi

# Wheels of ROS 2 leave this to their children; from another environment it names wrong libraries.
if [ -n "${_ROS_WHEELS_BOOTSTRAP_COMPLETE:-}" ]; then
  unset _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH
fi

main() {
  # Contents, not times, so that changing branches to and fro installs nothing.
  dependencies=$(cksum <setup.py)
  sources=$(fingerprint setup.py setup.cfg pyproject.toml package.xml \
    quad_mpc_ros config launch resource)
  environment_is_usable || make_environment
  if ! dependencies_are_installed; then
    install_everything
  elif [ "$(recorded sources)" != "$sources" ]; then
    install_ourselves
  fi
  export VIRTUAL_ENV=$venv
  export PATH=$venv/bin:$PATH
  export AMENT_PREFIX_PATH=$venv${AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}
  if [ -z "$sourced" ] && [ "${RMW_IMPLEMENTATION:-rmw_fastrtps_cpp}" != rmw_fastrtps_cpp ]; then
    echo "There is no wheel of $RMW_IMPLEMENTATION: using rmw_fastrtps_cpp"
    export RMW_IMPLEMENTATION=rmw_fastrtps_cpp
  fi
  exec "$@"
}

fail() {
  printf '%s\n' "$@" >&2
  exit 1
}

fingerprint() {
  find "$@" -type f ! -name '*.pyc' -exec cksum {} + | sort | cksum
}

recorded() {
  cat "$state/$1" 2>/dev/null || true
}

# What the environment was made from and where: it works with nothing else, nowhere else.
origin() {
  echo "$venv ${sourced:-wheels} $(readlink -f "$venv/bin/python" || true)"
}

environment_is_usable() {
  [ -x "$venv/bin/python" ] &&
    [ "$(recorded origin)" = "$(origin)" ] &&
    [ ! -e "$state/installing" ] &&
    { [ -z "${PYTHON:-}" ] || [ "$(recorded python)" = "$(command -v "$PYTHON")" ]; }
}

make_environment() {
  local python system_packages=()
  if [ -e "$venv" ] && [ ! -e "$state" ]; then
    fail "$venv exists and was not made by make. Remove it, or name another: make run VENV=.venv-2"
  fi
  case $sourced in
    jazzy | kilted)
      if ! python=$(MODULE=rclpy tools/find_python.sh 3.12 3.11 3.13); then
        fail "ROS 2 $sourced is sourced, so its own Python is needed. In a terminal that sources no" \
          "ROS the wheels of ROS 2 Jazzy are used instead."
      fi
      system_packages=(--system-site-packages)
      ;;
    '')
      [ -z "${ROS_DISTRO:-}" ] ||
        echo "ROS_DISTRO is $ROS_DISTRO, but no ROS is sourced: using the wheels of ROS 2 Jazzy"
      [[ " ${extras[*]} " != *' ros '* ]] || check_wheels_exist
      python=$(tools/find_python.sh 3.11 3.12 3.13) || exit 1
      ;;
    *)
      fail "ROS 2 $sourced is sourced, and quad_mpc_ros is for ROS 2 Jazzy and Kilted; they do not mix." \
        "Source one of these instead, or nothing: then the wheels of ROS 2 Jazzy are used."
      ;;
  esac
  echo "Making the virtual environment $venv with $python"
  rm -rf "$venv"
  mkdir -p "$state"
  "$python" -m venv "${system_packages[@]}" "$venv" ||
    fail "$python could not make a virtual environment in $venv."
  command -v "$python" >"$state/python"
  origin >"$state/origin"
}

check_wheels_exist() {
  local machine
  machine="$(uname -s) $(uname -m)"
  [ "$machine" = 'Linux x86_64' ] || fail \
    "There are no wheels of ROS 2 Jazzy for this machine ($machine), and no ROS 2 is sourced." \
    "Install ROS 2 Jazzy (Ubuntu 24.04: the package ros-jazzy-ros-base), then run" \
    "'source /opt/ros/jazzy/setup.bash' and this command again."
}

dependencies_are_installed() {
  local extra
  for extra in "${extras[@]}"; do
    grep -qsx "$extra" "$state/extras" || return 1
  done
  [ "$(recorded dependencies)" = "$dependencies" ]
}

install_everything() {
  local all wanted options=()
  # With those that are there already: pip forgets what earlier commands asked for.
  all=$({ recorded extras; printf '%s\n' "${extras[@]}"; } | sed '/^$/d' | sort -u)
  wanted=${all:+[${all//$'\n'/,}]}
  if [ -n "$sourced" ]; then
    # ROS is compiled for the system's numpy; the next major version would crash it.
    options=(--constraint "$state/constraints.txt")
    "$venv/bin/python" -c 'import numpy; print(f"numpy<{int(numpy.__version__[0]) + 1}")' \
      >"$state/constraints.txt"
  fi
  echo "Installing quad_mpc_ros and what it needs; the first time takes a minute or two"
  # setuptools is for install_ourselves.
  pip_install "$wanted" "${options[@]}" 'setuptools>=70.1'
  echo "$dependencies" >"$state/dependencies"
  echo "$all" >"$state/extras"
}

install_ourselves() {
  echo "Installing quad_mpc_ros again, for its files changed"
  pip_install '' --no-deps --force-reinstall --no-build-isolation
}

# pip_install '[EXTRAS]' PIP_OPTION...
pip_install() (
  wanted=$1
  shift
  : >"$log"
  trap pip_install_ended EXIT
  trap 'exit 130' INT TERM
  # A copy is built, or what was removed from the package would live on in build/.
  rm -rf "$copy"
  mkdir "$copy"
  cp -r setup.py setup.cfg pyproject.toml package.xml LICENSE \
    quad_mpc_ros config launch resource "$copy"
  touch "$state/installing"
  if ! "$venv/bin/python" -m pip --disable-pip-version-check --no-input install \
    --progress-bar off "$@" "$copy$wanted" 2>&1 | tee "$log" | show_progress; then
    grep -E '^ *(ERROR|error):' "$log" >&2 || tail -n 15 "$log" >&2
    fail "pip could not install quad_mpc_ros$wanted. Why: above; all it said: $log"
  fi
  echo "$sources" >"$state/sources"
  rm "$state/installing"
)

# An installation that ended while unpacking leaves its mark, because the environment may be incomplete.
pip_install_ended() {
  rm -rf "$copy"
  grep -q '^Installing collected packages' "$log" || rm -f "$state/installing"
}

# Shortens pip's output to a line every few seconds, also when pip is silent.
show_progress() {
  local line='' name doing='starting' count=0 shown=$SECONDS status
  while true; do
    status=0
    IFS= read -r -t 5 line || status=$?
    if [ "$status" -eq 0 ]; then
      case $line in
        'Collecting '*)
          count=$((count + 1))
          read -r _ name _ <<<"$line"
          doing="packages looked up: $count, now $name"
          ;;
        'Installing collected packages:'*) doing="unpacking $(wc -w <<<"${line#*:}") packages" ;;
        *Retrying*) doing='the package index does not answer, trying again' ;;
      esac
    elif [ "$status" -le 128 ]; then
      return
    fi
    if [ $((SECONDS - shown)) -ge 3 ]; then
      echo "  $doing"
      shown=$SECONDS
    fi
  done
}

main "$@"
