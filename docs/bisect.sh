#!/bin/sh
# Judges one commit for git bisect: 0 is good, 1 is bad, 125 means that the commit cannot be judged.
#
#   cp docs/bisect.sh .. && git bisect start BAD GOOD
#   git bisect run ../bisect.sh in.mcap criteria.toml [options of roadperc-replay]
#
# BUILD is a command that builds each commit, for example BUILD='python -m pip install -e .'
# CHECK is the roadperc-check to use, for commits that have none.
log=$1 criteria=$2
shift 2 || exit 125
folder=$(mktemp -d -t bisect.XXXXXX) || exit 125
trap 'rm -rf "$folder"' EXIT
trap 'exit 125' HUP INT TERM
if [ -n "$BUILD" ]; then
    sh -c "$BUILD" || exit 125
fi
roadperc-replay "$log" "$folder/run.mcap" --quiet "$@" || exit 125
"${CHECK:-roadperc-check}" "$folder/run.mcap" --criteria "$criteria"
case $? in
    0) exit 0 ;;
    1) trap - EXIT && exit 1 ;; # the folder stays for the printed commands
    *) exit 125 ;;
esac
