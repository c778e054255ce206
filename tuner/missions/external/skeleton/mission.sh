#!/bin/sh
# One mission: what it needs is in the environment (and as JSON in $GATETUNE_REQUEST); it leaves result.json in $GATETUNE_OUTPUT.
# An end without a result is the machine's failure: run again.
file=$GATETUNE_INSTANCE.raw
filters=
[ "$PARAMETER_delta" != 0 ] && filters=--delta=dist=$PARAMETER_delta
options=lc=$PARAMETER_lc,lp=$PARAMETER_lp,pb=$PARAMETER_pb,nice=$PARAMETER_nice
xz --stdout --format=raw $filters --lzma2="$options" "$file" > "$GATETUNE_OUTPUT/packed"
case $? in
  0) percent=$(echo "$(wc -c < "$GATETUNE_OUTPUT/packed") $(wc -c < "$file")" | awk '{printf "%.6f", 100 * $1 / $2}')
     result='{"metrics": {"packed_percent": '$percent'}}' ;;
  1) result='{"failure": "refused"}' ;;
  *) exit 1 ;;
esac
echo "$result" > "$GATETUNE_OUTPUT/result.json"
