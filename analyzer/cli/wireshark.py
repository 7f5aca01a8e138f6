"""Print a dissector for Wireshark, one Lua file made from the manuals: CAN, serial lines, terminal servers.

Wireshark 3.6 and newer loads it from the folder of personal Lua plugins (Help, About, Folders), tshark with -X lua_script:FILE.
"""

from __future__ import annotations

import argparse

from analyzer import dialects as registry
from analyzer.cli.output import add_text_output, deliver
from analyzer.errors import UsageError
from analyzer.reference.wireshark import dissector

EXAMPLES = """\
examples:
  servotap wireshark -o servotap.lua
  tshark -X lua_script:servotap.lua -r can.pcapng -Y servotap
  tshark -X lua_script:servotap.lua -r lines.pcapng -d rtacser.data,servotap
  tshark -X lua_script:servotap.lua -r lines.pcap -o 'uat:user_dlts:"User 0 (DLT=147)","servotap","0","","0",""'
  tshark -X lua_script:servotap.lua -r net.pcapng -d tcp.port==4001,servotap -T fields -e servotap.mks_can.read_speed.speed
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--dialect", metavar="D,...", help="only these dialects; all by default")
    add_text_output(parser)


def run(arguments: argparse.Namespace) -> int:
    """Print the file; return 0."""
    names = arguments.dialect.split(",") if arguments.dialect else []
    chosen = [registry.get(name.strip()) for name in names] or registry.every()
    try:
        text = dissector(chosen)
    except ValueError as error:
        raise UsageError(str(error)) from None
    deliver(text, arguments)
    return 0
