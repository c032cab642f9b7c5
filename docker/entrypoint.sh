#!/bin/sh
# Read secrets from the files that are named, so that they can stay out of the container's configuration. Then become the
# command.
set -eu

# read_secret VARIABLE MEANING: set 'secret' from the file that VARIABLE names.
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
    # Treat an empty token as none.
    unset WRONGTURN_OPERATOR_TOKEN
fi

read_secret WRONGTURN_OWNER_TOKEN_FILE "owner's token"
if [ -n "$secret" ]; then
    export WRONGTURN_OWNER_TOKEN="$secret"
fi

read_secret WRONGTURN_DATABASE_PASSWORD_FILE password
if [ -n "$secret" ]; then
    # PostgreSQL's own programs read this too, and the URL then needs no password.
    export PGPASSWORD="$secret"
fi
unset secret file
exec "$@"
