# make demo    reconstruct the squash that ships with the package into out/squash
# make test    ruff, pyright, pytest        make lint    the first two alone
# make bench   accuracy and speed, beside the peers (minutes)
# Each sets the machine up first: .venv, dependencies, the off-screen OpenGL library; test also a browser for the studio,
# without which its tests are skipped. Quick when nothing is missing.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.ONESHELL:
.DELETE_ON_ERROR:
.PHONY: demo test lint bench setup clean

PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
BROWSER := .venv/.browser

demo: $(READY)
	@$(BIN)/symseek demo

test: lint $(BROWSER)
	@$(BIN)/python -m pytest -rs

lint: $(READY)
	@$(BIN)/ruff check
	$(BIN)/pyright

bench: $(READY)
	@$(BIN)/python -m benchmarks

setup: $(READY)

clean:
	rm -rf .venv build dist out *.egg-info

$(READY): pyproject.toml
	@say() { printf '%s\n' "$$*" >&2; }
	# as root directly, otherwise by a sudo that asks nothing
	root() { if [ "$$(id -u)" = 0 ]; then "$$@"; else sudo -n "$$@"; fi; }
	has() { "$$python" -c "import ctypes.util, sys; sys.exit(ctypes.util.find_library('$$1') is None)"; }
	apt() {
	    root apt-get update -qq && root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$$@" >/dev/null
	}
	python=$(PYTHON)
	"$$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || {
	    say "symseek needs Python 3.11 or later, and '$$python' is not one. Install it, or name it: make PYTHON=/path/to/python3.11"
	    exit 1
	}
	if [ ! -x $(BIN)/pip ]; then
	    if ! "$$python" -c 'import ensurepip, venv' 2>/dev/null; then
	        say "installing python3-venv ..."
	        apt python3-venv || {
	            say "Python's venv is missing and could not be installed. As root: apt-get install python3-venv"
	            exit 1
	        }
	    fi
	    say "making .venv ..."
	    "$$python" -m venv --clear .venv
	fi
	if ! has OSMesa; then
	    say "installing libosmesa6 (off-screen OpenGL) ..."
	    if ! apt libosmesa6; then
	        has EGL || {
	            say "No off-screen OpenGL: neither OSMesa nor EGL is here. As root: apt-get install libosmesa6"
	            exit 1
	        }
	        say "libosmesa6 could not be installed; EGL is here and will be used."
	    fi
	fi
	say "installing symseek and its dependencies into .venv, a minute or two ..."
	$(BIN)/python -m pip install -q --disable-pip-version-check 'pip>=25.1'
	$(BIN)/python -m pip install -qq -e '.[studio,cameras]' --group dev
	touch $@

$(BROWSER): $(READY)
	@if ! command -v chromium chromium-browser google-chrome >/dev/null; then
	    root() { if [ "$$(id -u)" = 0 ]; then "$$@"; else sudo -n "$$@"; fi; }
	    echo "installing chromium (for the studio's tests) ..." >&2
	    root apt-get update -qq &&
	        root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium >/dev/null ||
	        { echo "Chromium could not be installed: the studio's tests are skipped. As root: apt-get install chromium" >&2; exit 0; }
	fi
	touch $@
