"""Keeps the network out of DDS sockets that are meant for this machine.

CycloneDDS binds the sockets that it receives on to all addresses, whatever interface it is given,
and so does ROS 2 with localhost only. On Linux a filter of the kernel's then drops what was not
sent to 127.0.0.0/8, and multicast that did not come over the loopback interface. So nothing that
comes from other machines is left. It needs no rights.
"""

from __future__ import annotations

import ctypes
import os
import socket
import struct
import sys
from contextlib import closing
from pathlib import Path
from typing import Final

_ATTACH_FILTER: Final = 26  # SO_ATTACH_FILTER
_NETWORK_HEADER: Final = 0xFFF00000  # SKF_NET_OFF: offsets from the start of the IP header
_INTERFACE: Final = 0xFFFFF008  # SKF_AD_OFF + SKF_AD_IFINDEX: the index of the interface
_MOST: Final = 0xFFFFFFFF


def _filter(loopback: int) -> tuple[tuple[int, int, int, int], ...]:
    """Classic BPF, a line each: operation, lines to skip if true, if false, operand."""
    return (
        (0x20, 0, 0, _NETWORK_HEADER + 16),  # load the destination address
        (0x54, 0, 0, 0xFF000000),  # keep its first byte
        (0x15, 3, 0, 0x7F000000),  # 127: take it
        (0x35, 0, 3, 0xE0000000),  # below 224, which is no multicast: drop it
        (0x20, 0, 0, _INTERFACE),  # load the interface
        (0x15, 0, 1, loopback),  # another: drop it
        (0x06, 0, 0, _MOST),  # take the packet
        (0x06, 0, 0, 0),  # drop it
    )


def keep_network_out(domain: int) -> bool:
    """Filter the sockets of this process that receive in a DDS domain.

    Args:
        domain: whose ports they have, 250 from 7400 on for each domain.

    Returns:
        whether that is possible here: on Linux alone.
    """
    if sys.platform != "linux":
        return False
    ports = range(7400 + 250 * domain, 7400 + 250 * (domain + 1))
    for link in Path("/proc/self/fd").iterdir():
        try:
            if not os.readlink(link).startswith("socket:"):
                continue
            with closing(socket.socket(fileno=os.dup(int(link.name)))) as found:
                udp = found.family == socket.AF_INET and found.type == socket.SOCK_DGRAM
                if udp and found.getsockname()[1] in ports:
                    accept_loopback_only(found)
        except OSError:  # closed meanwhile, by another thread
            continue
    return True


def accept_loopback_only(receiver: socket.socket) -> None:
    """Drop what comes to an IPv4 socket from outside this machine (Linux).

    Raises:
        OSError: the kernel takes no filter.
    """
    lines = _filter(socket.if_nametoindex("lo"))
    code = b"".join(struct.pack("=HBBI", *line) for line in lines)
    memory = ctypes.create_string_buffer(code, len(code))
    program = struct.pack("@HP", len(lines), ctypes.addressof(memory))
    receiver.setsockopt(socket.SOL_SOCKET, _ATTACH_FILTER, program)
