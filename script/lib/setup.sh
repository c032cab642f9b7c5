# Sourced by script/demo and script/test. Make .venv and install what is missing. Later runs are quick.
#   setup run    install what the service, the client and the agents need (no torch)
#   setup test   also install what the tests and the documentation need
# shellcheck shell=bash

# Packages are installed without compiled modules: pip would compile 20,000 and takes a minute for them, while a third is
# used. Python keeps what it compiles when it first imports a module.
unset PYTHONDONTWRITEBYTECODE

say() { printf '%s\n' "$*" >&2; }

fail() {
  say "error: $*"
  exit 1
}

# Libraries that libsumo is linked to, and that slim images lack.
declare -A LIBRARIES=(
  [libX11.so.6]=libx11-6 [libXext.so.6]=libxext6 [libXrender.so.1]=libxrender1 [libGL.so.1]=libgl1
  [libatomic.so.1]=libatomic1
)

find_python() {
  local candidate
  for candidate in python3.11 python3 python3.12 python3.13 python3.14; do
    if command -v "$candidate" >/dev/null &&
      "$candidate" -c 'import sys; raise SystemExit(sys.version_info < (3, 11))' 2>/dev/null; then
      printf '%s\n' "$candidate"
      return
    fi
  done
  fail "no Python 3.11 or newer is on the PATH. Install it; on Debian 12: apt-get install python3 python3-venv"
}

missing_packages() {
  local python=$1 library
  "$python" -c 'import ensurepip, venv' 2>/dev/null || printf 'python3-venv\n'
  for library in "${!LIBRARIES[@]}"; do
    "$python" -c 'import ctypes, sys; ctypes.CDLL(sys.argv[1])' "$library" 2>/dev/null ||
      printf '%s\n' "${LIBRARIES[$library]}"
  done
}

install_packages() {
  local -a as_root=() packages=("$@")
  if ((EUID != 0)); then
    command -v sudo >/dev/null && sudo -n true 2>/dev/null ||
      fail "these Debian packages are missing: ${packages[*]}. Install them (apt-get install ${packages[*]}) or run this as root"
    as_root=(sudo -n)
  fi
  command -v apt-get >/dev/null ||
    fail "these Debian packages are missing: ${packages[*]}. There is no apt-get here, so install your system's equivalents"
  say "Installing ${packages[*]} …"
  "${as_root[@]}" apt-get update -qq >&2 &&
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
      "${packages[@]}" >/dev/null ||
    fail "apt-get could not install ${packages[*]}; see its message above"
}

# The sandbox of submitted models. The tests that need it are skipped where it cannot be installed.
install_bubblewrap() {
  command -v bwrap >/dev/null || (install_packages bubblewrap) || say "Going on without bubblewrap."
}

# The browser of the tests of pages. They are skipped where it cannot be installed.
install_chromium() {
  command -v chromium >/dev/null || (install_packages chromium) || say "Going on without chromium."
}

setup() {
  local level=$1 python stamp digest
  local -a packages
  # A second run waits for the first and then finds everything done.
  if command -v flock >/dev/null; then
    exec 9>.venv.lock
    flock 9
  fi
  digest=$(cat constraints.txt pyproject.toml ./*/pyproject.toml plugins/*/pyproject.toml script/lib/setup.sh | sha256sum | cut -c1-64)
  stamp=.venv/.wrongturn-$level
  if [[ -x .venv/bin/python && -f $stamp && $(<"$stamp") == "$digest $PWD" ]]; then
    exec 9>&-
    return
  fi
  python=$(find_python) || exit 1
  mapfile -t packages < <(missing_packages "$python" | sort -u)
  ((${#packages[@]} == 0)) || install_packages "${packages[@]}"
  [[ $level == run ]] || { install_bubblewrap && install_chromium; }
  say "Setting up .venv (this takes a few minutes, once) …"
  if ! .venv/bin/python -c 'import pip, sys; raise SystemExit(sys.version_info < (3, 11))' 2>/dev/null; then
    "$python" -m venv --clear .venv || fail "$python -m venv .venv failed; see its message above"
  fi
  pip() { .venv/bin/python -m pip -qq --disable-pip-version-check "$@" --no-compile; }
  pip install --upgrade 'pip>=25.1' setuptools || fail "pip could not upgrade itself; see its message above"
  # Our parts are built by the setuptools above. Otherwise pip would install another for each of them, which takes 15 s.
  local -a wanted=(--no-build-isolation -c constraints.txt -e clients -e networks -e 'service[server]' -e agents)
  if [[ $level == test ]]; then
    # Install torch first and alone, so that no other package's range picks another build of it.
    pip install -c constraints.txt torch || fail "pip could not install torch; see its message above"
    wanted+=(-e 'agents[training,onnx]' -e plugins/certificates -e plugins/exploits -e plugins/figures -e plugins/lbc -e plugins/marln -e plugins/openenv -e plugins/ray -e plugins/sb3 -e plugins/statistics --group test)
  fi
  pip install "${wanted[@]}" || fail "pip could not install the packages; see its message above"
  # The tests need OpenEnv's client alone. Its server brings 100 more packages and an older pillow than ours.
  # openapi-python-client asks for an older typer than ours, and works with this one.
  [[ $level == run ]] || pip install -c constraints.txt --no-deps openenv-core openapi-python-client ruamel.yaml shellingham ||
    fail "pip could not install openenv-core and openapi-python-client; see its message above"
  printf '%s' "$digest $PWD" >.venv/.wrongturn-run
  printf '%s' "$digest $PWD" >"$stamp"
  exec 9>&-
}
