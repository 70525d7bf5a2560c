# Sourced by demo.sh and test.sh, in the project's root. Defines
#
#   setup EXTRA [DEBIAN PACKAGE …]
#
# which creates .venv with rhi[EXTRA], and installs those Debian packages (drivers) that are missing if this user may.
# It prints what it installs.

say() { printf '[setup] %s\n' "$*"; }

install_packages() {
    local missing=()
    local package
    for package in "$@"; do
        dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'install ok installed' || missing+=("$package")
    done
    [ ${#missing[@]} -eq 0 ] && return 0
    local sudo=""
    if [ "$(id -u)" -ne 0 ]; then
        if ! command -v sudo >/dev/null || ! sudo -n true 2>/dev/null; then
            say "system packages are missing, and this user can't install them: ${missing[*]}"
            say "as an administrator: apt-get install ${missing[*]}"
            return 0
        fi
        sudo="sudo"
    fi
    say "installing system packages: ${missing[*]}"
    $sudo apt-get update -qq || true
    DEBIAN_FRONTEND=noninteractive $sudo apt-get install -o DPkg::Lock::Timeout=300 -y -qq --no-install-recommends "${missing[@]}" >/dev/null ||
        say "apt-get could not install: ${missing[*]} (continuing without them)"
}

find_python() {
    local candidate
    for candidate in "${PYTHON:-}" python3.11 python3.12 python3.13 python3; do
        [ -n "$candidate" ] || continue
        command -v "$candidate" >/dev/null || continue
        "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || continue
        echo "$candidate"
        return 0
    done
    return 1
}

setup() {
    local extra="$1"
    shift
    if command -v dpkg-query >/dev/null && command -v apt-get >/dev/null; then
        install_packages "$@"
        find_python >/dev/null || install_packages python3 python3-venv
    fi
    local python
    python="$(find_python)" || { say "Python 3.11 or newer is needed"; exit 1; }
    if [ ! -x .venv/bin/python ]; then
        "$python" -c 'import ensurepip' 2>/dev/null || install_packages python3-venv
        say "creating .venv with $("$python" --version)"
        "$python" -m venv .venv
    fi
    # A file named after the checksum of pyproject.toml and of the packages' names records that they are installed, so
    # that a second run starts at once.
    local stamp
    stamp=".venv/.setup-$extra-$( (cat pyproject.toml; ls -d ./*/__init__.py) | cksum | tr ' ' '-')"
    if [ ! -e "$stamp" ]; then
        say "installing Python packages: rhi[$extra]"
        local told  # pip warns of what isn't ours to change, such as being root: shown only if it fails
        told="$(.venv/bin/python -m pip install --quiet --disable-pip-version-check --editable ".[$extra]" 2>&1)" || {
            printf '%s\n' "$told" >&2
            exit 1
        }
        rm -f .venv/.setup-"$extra"-*
        touch "$stamp"
    fi
}
