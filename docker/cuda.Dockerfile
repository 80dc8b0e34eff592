# bough on an NVIDIA GPU; the host has the driver and the NVIDIA container toolkit. From the repository's root:
#   docker build --file docker/cuda.Dockerfile --tag bough:cuda .
#   docker run --rm --gpus all --volume "$PWD:/work" --user "$(id -u):$(id -g)" bough:cuda info
ARG PYTHON=3.12
FROM python:${PYTHON}-slim

# Compiled kernels stay in /cache: mount a volume there to keep them. A user who is on no list has no name and no home.
ENV WARP_CACHE_PATH=/cache/warp MPLCONFIGDIR=/cache/matplotlib HOME=/cache USER=bough PIP_NO_CACHE_DIR=1
ENV NVIDIA_VISIBLE_DEVICES=all NVIDIA_DRIVER_CAPABILITIES=compute,utility
RUN mkdir --mode=1777 /cache /work

# torch and Warp bring CUDA along, so that no CUDA image is needed. PyPI's torch is the build for CUDA 13; for an older
# driver name another index: --build-arg TORCH_INDEX=https://download.pytorch.org/whl/cu126
ARG TORCH_INDEX=https://pypi.org/simple
COPY constraints.txt /src/
RUN pip install torch --constraint /src/constraints.txt --index-url ${TORCH_INDEX}

COPY pyproject.toml README.md LICENSE __init__.py __main__.py envs.py version.py py.typed /src/
COPY cli /src/cli
COPY kernels /src/kernels
COPY learn /src/learn
COPY perception /src/perception
COPY sim /src/sim
RUN pip install "/src[all]" --constraint /src/constraints.txt

WORKDIR /work
USER 1000
ENTRYPOINT ["bough"]
CMD ["--help"]
