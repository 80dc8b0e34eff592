# bough on a CPU. From the repository's root:
#   docker build --file docker/cpu.Dockerfile --tag bough .
#   docker run --rm --volume "$PWD:/work" --user "$(id -u):$(id -g)" bough forest --out forest
ARG PYTHON=3.12
FROM python:${PYTHON}-slim

# Compiled kernels stay in /cache: mount a volume there to keep them. A user who is on no list has no name and no home.
ENV WARP_CACHE_PATH=/cache/warp MPLCONFIGDIR=/cache/matplotlib HOME=/cache USER=bough PIP_NO_CACHE_DIR=1
RUN mkdir --mode=1777 /cache /work

# The CPU build of torch, a tenth of the CUDA build's size.
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
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
