# The steps of README.md in a clean Ubuntu, without ROS:  docker build -t wam_power_ros . && docker run -it wam_power_ros
FROM ubuntu:24.04
RUN apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
    git make python3-venv python3-dev build-essential libgomp1 libegl1 libgl1 && rm -rf /var/lib/apt/lists/*
COPY . /wam_power_ros
WORKDIR /wam_power_ros
RUN make venv
CMD ["make", "learn"]
