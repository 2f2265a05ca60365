# docker build -t roomfit . && docker run --rm -v "$PWD:/data" roomfit identify campaign.toml --out result
FROM python:3.11-slim
WORKDIR /opt/roomfit
COPY requirements ./requirements
RUN pip install --no-cache-dir --require-hashes -r requirements/build.txt \
    && pip install --no-cache-dir --require-hashes -r requirements/user.txt
COPY pyproject.toml README.md LICENSE ./
COPY src ./src
RUN pip install --no-cache-dir --no-deps --no-build-isolation .
RUN useradd --create-home acoustician
USER acoustician
WORKDIR /data
ENTRYPOINT ["roomfit"]
CMD ["--help"]
