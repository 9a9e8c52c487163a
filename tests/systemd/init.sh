#!/bin/sh
# Process 1 of the guest until systemd is: a Debian of its own, over which all writing goes to memory, with this
# project and its Python in it. The machine's own files are read-only.
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
here=$(dirname "$0")
layers=$here/tmp
new=$layers/root

mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t tmpfs tmpfs /run
mount -t tmpfs tmpfs "$layers"
mkdir -p "$layers/upper" "$layers/work" "$new" /run/kernel/lib/modules
mount --bind /usr/lib/uml/modules /run/kernel/lib/modules
modprobe -d /run/kernel overlay
mount -t overlay overlay -o "lowerdir=$(cat "$here/debian"),upperdir=$layers/upper,workdir=$layers/work" "$new"

mkdir -p "$new/lib/modules"
mount --bind /usr/lib/uml/modules "$new/lib/modules"
while IFS='	' read -r from to; do
	mkdir -p "$new$to"
	mount --bind "$from" "$new$to"
done <"$here/mounts"
mkdir -p "$new$here"
mount -t hostfs none "$new$here" -o "$here"
mount -t tmpfs tmpfs "$new$here/tmp"

# An installation as the README has it, which needs no home folder and no /tmp.
python=$new/opt/candaemon
mkdir -p "$python/bin" "$python/lib/$(cat "$here/python")/site-packages"
echo "home = $(cat "$here/home")" >"$python/pyvenv.cfg"
ln -s "$(cat "$here/home")/$(cat "$here/python")" "$python/bin/python"
printf '%s\n' /opt/project /opt/packages >"$python/lib/$(cat "$here/python")/site-packages/candaemon.pth"
printf '%s\n' '#!/opt/candaemon/bin/python' 'import sys' 'from candaemon.cli.main import main' 'sys.exit(main())' \
	>"$python/bin/candaemon"
chmod 755 "$python/bin/candaemon"

for library in "$new"/opt/python/lib/libpython*.so*; do
	[ ! -e "$library" ] || ln -s "${library#"$new"}" "$new/usr/lib/" # where every program looks
done

units=$new/etc/systemd/system
# Nobody logs in and nothing is due, which saves seconds; /tmp is not to be cleared, for what is mounted there.
for unit in getty.target timers.target systemd-logind.service systemd-user-sessions.service e2scrub_reap.service \
	proc-sys-fs-binfmt_misc.automount systemd-binfmt.service; do
	ln -s /dev/null "$units/$unit"
done
ln -s /dev/null "$new/etc/tmpfiles.d/tmp.conf"
cp "$here/command" "$new/etc/bed"
cat >"$units/bed.service" <<'UNIT'
[Unit]
Description=The tests
[Service]
Type=exec
ExecStart=/bin/sh /etc/bed
ExecStopPost=systemctl poweroff --force --force
TimeoutStartSec=infinity
UNIT
mkdir -p "$units/multi-user.target.wants"
ln -s ../bed.service "$units/multi-user.target.wants/bed.service"

: >"$new$here/started"
export SYSTEMD_COLORS=0
exec switch_root "$new" /lib/systemd/systemd
