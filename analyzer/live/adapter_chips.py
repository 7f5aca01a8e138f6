"""What serial adapters are, from the numbers that USB gives them or the driver that the kernel does.

Facts of the vendors and of Linux's drivers. A number that is not here is shown by its driver, or as it is.
"""

from __future__ import annotations

#: (vendor, product) -> chip; product None: any other of that vendor.
_CHIPS: dict[tuple[int, int | None], str] = {
    (0x0403, 0x6001): "FTDI FT232R",
    (0x0403, 0x6010): "FTDI FT2232",
    (0x0403, 0x6011): "FTDI FT4232",
    (0x0403, 0x6014): "FTDI FT232H",
    (0x0403, 0x6015): "FTDI FT230X/FT231X",
    (0x0403, 0xFFA8): "Lawicel CANUSB (slcan)",
    (0x0403, None): "FTDI",
    (0x1A86, 0x7522): "WCH CH340K",
    (0x1A86, 0x7523): "WCH CH340",
    (0x1A86, 0x5523): "WCH CH341",
    (0x1A86, 0x55D2): "WCH CH342",
    (0x1A86, 0x55D3): "WCH CH343",
    (0x1A86, 0x55D4): "WCH CH9102",
    (0x1A86, 0x55D5): "WCH CH344",
    (0x1A86, 0x55D8): "WCH CH9101",
    (0x1A86, None): "WCH",
    (0x10C4, 0xEA60): "Silicon Labs CP210x (CP2102, CP2104)",
    (0x10C4, 0xEA70): "Silicon Labs CP2105",
    (0x10C4, 0xEA71): "Silicon Labs CP2108",
    (0x10C4, None): "Silicon Labs",
    (0x067B, 0x2303): "Prolific PL2303",
    (0x067B, 0x23A3): "Prolific PL2303GC",
    (0x067B, None): "Prolific",
    (0x04D8, None): "Microchip",
    (0x0483, 0x5740): "STM32 virtual COM port",
    (0x16D0, 0x117E): "CANable (slcan)",
    (0xAD50, 0x60C4): "CANable (slcan)",
    (0x2341, None): "Arduino",
    (0x2E8A, None): "Raspberry Pi microcontroller",
    (0x303A, None): "Espressif",
}

_DRIVERS = {
    "ftdi_sio": "FTDI",
    "ch341": "WCH CH340/CH341",
    "ch341-uart": "WCH CH340/CH341",
    "cp210x": "Silicon Labs CP210x",
    "pl2303": "Prolific PL2303",
    "cdc_acm": "USB modem class (CDC ACM)",
    "serial8250": "built-in port (8250)",
    "port": "built-in port",
    "uart-pl011": "built-in port (PL011)",
    "bcm2835-aux-uart": "built-in port (mini UART)",
}

_SLCAN = frozenset({(0x0403, 0xFFA8), (0x16D0, 0x117E), (0xAD50, 0x60C4)})


def chip_of(vendor: int | None, product: int | None, driver: str) -> str:
    """Return what an adapter is, in words; "unknown" where nothing tells."""
    if vendor is not None:
        chip = _CHIPS.get((vendor, product)) or _DRIVERS.get(driver) or _CHIPS.get((vendor, None))
        return chip or f"USB adapter {vendor:04x}:{product or 0:04x}"
    return _DRIVERS.get(driver) or (f"built-in port ({driver})" if driver else "unknown")


def speaks_slcan(vendor: int | None, product: int | None) -> bool:
    """Say whether an adapter is known to be one of CAN that speaks slcan over its serial port."""
    return (vendor, product) in _SLCAN
