#!/bin/sh
# Process 1 of the guest, whose root is the machine's own, read-only: makes CAN ready, runs the tests, powers off.
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
here=$(dirname "$0")

mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t tmpfs tmpfs /run
mount -t devtmpfs devtmpfs /dev 2>/run/devtmpfs # some kernels have mounted it
mkdir -p /dev/shm /dev/pts
mount -t tmpfs tmpfs /dev/shm
mount -t devpts devpts /dev/pts
mount -t hostfs none "$here" -o "$here"
mount -t tmpfs tmpfs "$here/tmp"
: >"$here/started"

# modprobe wants modules below lib/modules.
mkdir -p /run/kernel/lib/modules
mount --bind /usr/lib/uml/modules /run/kernel/lib/modules
modprobe -d /run/kernel -a can-raw vcan vxcan can-gw sch_tbf
ip link set lo up

sh "$here/command"
sync
echo o >/proc/sysrq-trigger
sleep 60
