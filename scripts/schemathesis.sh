#!/usr/bin/env bash
# Tries the running service against openapi.yaml with schemathesis (https://schemathesis.io).
# Installs it into target/schemathesis; further arguments go to `schemathesis run`.
set -euo pipefail
cd "$(dirname "$0")/.."

venv=target/schemathesis
if [ ! -x "$venv/bin/schemathesis" ]; then
  python3 -m venv "$venv"
  "$venv/bin/pip" install --quiet schemathesis==4.32.5 backports.zstd
fi
cargo build --quiet

work=$(mktemp -d)
target/debug/rosaline serve --listen 127.0.0.1:0 --data "$work/data" >"$work/address" 2>"$work/log" &
service=$!
trap 'kill $service 2>/dev/null || true; wait $service 2>/dev/null || true; rm -rf "$work"' EXIT
for _ in $(seq 100); do
  grep -q listening "$work/address" && break
  kill -0 $service 2>/dev/null || { cat "$work/log"; exit 1; }
  sleep 0.1
done
url=$(sed 's/listening on //' "$work/address")

# It writes its database of examples into the working folder.
schemathesis=$PWD/$venv/bin/schemathesis
config=$PWD/scripts/schemathesis
cd "$work"
cp "$config"/* .
"$schemathesis" --config-file schemathesis.toml run "$url/openapi.yaml" \
  --max-examples "${EXAMPLES:-20}" --seed "${SEED:-1}" --continue-on-failure "$@"
