# The demo: docker build -t surefoot . && docker run --rm -v "$PWD/out:/surefoot/out" surefoot
FROM python:3.11-slim
RUN apt-get update \
    && apt-get install -y --no-install-recommends gcc libc6-dev libegl1 libgl1-mesa-dri make \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /surefoot
COPY . .
RUN make .venv/.demo
CMD ["make", "demo"]
