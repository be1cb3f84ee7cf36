#!/bin/bash
# Sources the setup files among the arguments, then becomes the command that follows them.
set -e
while [[ $1 == */*setup.bash ]]; do
  # shellcheck disable=SC1090
  source "$1" --  # without it, the file would read the arguments of this script
  shift
done
exec "$@"
