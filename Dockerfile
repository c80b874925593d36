# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
# Flies the square, and leaves its bag and figures in runs/:
#   docker build --tag quad_mpc_ros .
#   docker run --rm --volume "$PWD/runs:/home/ubuntu/runs" quad_mpc_ros
FROM ros:jazzy-ros-base

SHELL ["/bin/bash", "-o", "pipefail", "-c"]
WORKDIR /workspace

# What package.xml names, from Ubuntu and from ROS. Their versions are those of the release.
COPY package.xml requirements.txt src/quad_mpc_ros/
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends python3-venv \
    && rosdep update --rosdistro jazzy \
    && rosdep install --default-yes --rosdistro jazzy --dependency-types exec --from-paths src \
    && rm -rf /var/lib/apt/lists/*

# What neither of them has, into an environment that sees the rest: Ubuntu's Python takes none.
ENV VIRTUAL_ENV=/opt/quad_mpc PATH=/opt/quad_mpc/bin:$PATH
RUN python3 -m venv --system-site-packages /opt/quad_mpc \
    && pip install --no-cache-dir --requirement src/quad_mpc_ros/requirements.txt

COPY . src/quad_mpc_ros
RUN . /opt/ros/jazzy/setup.bash \
    && colcon build --packages-select quad_mpc_ros

# ubuntu, in whose cache the compiled code is
USER 1000
WORKDIR /home/ubuntu
RUN . /workspace/install/setup.bash \
    && ros2 run quad_mpc_ros quad_mpc compile
ENTRYPOINT ["/bin/bash", "-c", "source /workspace/install/setup.bash && exec \"$@\"", "--"]
CMD ["ros2", "run", "quad_mpc_ros", "quad_mpc", "fly"]
