#!/bin/sh
# Reads the operator's token from a file, where one is named, so that it need not stand in the environment of the
# container's configuration; then becomes the command.
set -eu
file=${WRONGTURN_OPERATOR_TOKEN_FILE:-}
unset WRONGTURN_OPERATOR_TOKEN_FILE
if [ -n "$file" ]; then
    if [ ! -r "$file" ]; then
        echo "WRONGTURN_OPERATOR_TOKEN_FILE: cannot read $file; mount it and let user $(id -u) read it" >&2
        exit 78
    fi
    WRONGTURN_OPERATOR_TOKEN=$(cat "$file")
    if [ -z "$WRONGTURN_OPERATOR_TOKEN" ]; then
        echo "WRONGTURN_OPERATOR_TOKEN_FILE: $file is empty; write the token into it" >&2
        exit 78
    fi
    export WRONGTURN_OPERATOR_TOKEN
elif [ -z "${WRONGTURN_OPERATOR_TOKEN:-}" ]; then
    # An empty token is no token.
    unset WRONGTURN_OPERATOR_TOKEN
fi
exec "$@"
