#!/bin/sh
# Reads secrets from files, where some are named, so that they need not stand in the environment of the container's
# configuration; then becomes the command.
set -eu

# read_secret VARIABLE MEANING: sets it from the file that VARIABLE_FILE or its like names.
read_secret() {
    eval "file=\${$1:-}"
    unset "$1"
    secret=
    [ -n "$file" ] || return 0
    if [ ! -r "$file" ]; then
        echo "$1: cannot read $file; mount it and let user $(id -u) read it" >&2
        exit 78
    fi
    secret=$(cat "$file")
    if [ -z "$secret" ]; then
        echo "$1: $file is empty; write the $2 into it" >&2
        exit 78
    fi
}

read_secret WRONGTURN_OPERATOR_TOKEN_FILE token
if [ -n "$secret" ]; then
    export WRONGTURN_OPERATOR_TOKEN="$secret"
elif [ -z "${WRONGTURN_OPERATOR_TOKEN:-}" ]; then
    # An empty token is no token.
    unset WRONGTURN_OPERATOR_TOKEN
fi

read_secret WRONGTURN_DATABASE_PASSWORD_FILE password
if [ -n "$secret" ]; then
    # What PostgreSQL's own programs read too; the URL then needs none.
    export PGPASSWORD="$secret"
fi
unset secret file
exec "$@"
