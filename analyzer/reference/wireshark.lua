-- Servotap for Wireshark 3.6 and newer: servo drives on CAN, serial lines and terminal servers.
-- `servotap wireshark` writes this file: tables made from the manuals, then the engine that reads frames by them.
--
--   CAN (SocketCAN)      found by itself; or Decode As, CAN next level, Servotap
--   RTAC serial          Decode As, RTAC Serial, Servotap          tshark -d rtacser.data,servotap
--   USER link types      Preferences, Protocols, DLT_USER: payload dissector servotap
--   terminal servers     Decode As, TCP port, Servotap             tshark -d tcp.port==4001,servotap
--
-- What it cannot do: bytes of one frame in several packets are marked as cut; noise between frames is passed, not explained.

--[[ tables ]]

local proto = Proto("servotap", "Servotap")
proto.prefs.dialect = Pref.string("Dialect of serial lines", "auto", "a name such as mks-rs485, or auto: the one that fits")

-- Fields and expert infos --------------------------------------------------------------------------------------------

local TYPES = {
  uint32 = ftypes.UINT32, int32 = ftypes.INT32, uint64 = ftypes.UINT64, int64 = ftypes.INT64,
  double = ftypes.DOUBLE, bytes = ftypes.BYTES,
}
local own = {
  dialect = ProtoField.string("servotap.dialect", "Dialect"),
  address = ProtoField.uint16("servotap.address", "Address"),
  command = ProtoField.string("servotap.command", "Command"),
  role = ProtoField.string("servotap.role", "Role"),
  section = ProtoField.string("servotap.section", "Section of the manual"),
  erratum = ProtoField.string("servotap.erratum", "Erratum of the manual"),
  checksum = ProtoField.bytes("servotap.checksum", "Checksum"),
  checksum_ok = ProtoField.bool("servotap.checksum_ok", "Checksum is right"),
  frame = ProtoField.bytes("servotap.frame", "Frame"),
  junk = ProtoField.bytes("servotap.junk", "No frame"),
  request_in = ProtoField.framenum("servotap.request_in", "Request in", base.NONE, frametype.REQUEST),
  reply_in = ProtoField.framenum("servotap.reply_in", "Reply in", base.NONE, frametype.RESPONSE),
  latency = ProtoField.double("servotap.latency", "Latency (s)"),
  raw_data = ProtoField.bytes("servotap.data", "Data"),
}
local expert = {
  checksum = ProtoExpert.new("servotap.bad_checksum", "wrong checksum", expert.group.CHECKSUM, expert.severity.ERROR),
  out_of_range = ProtoExpert.new("servotap.out_of_range", "value out of range", expert.group.PROTOCOL, expert.severity.WARN),
  unknown_choice = ProtoExpert.new("servotap.unknown_choice", "value that is not listed", expert.group.PROTOCOL, expert.severity.WARN),
  reserved_bits = ProtoExpert.new("servotap.reserved_bits", "reserved bits are set", expert.group.PROTOCOL, expert.severity.NOTE),
  wrong_length = ProtoExpert.new("servotap.wrong_length", "wrong length", expert.group.MALFORMED, expert.severity.ERROR),
  unknown_command = ProtoExpert.new("servotap.unknown_command", "not in the manual", expert.group.UNDECODED, expert.severity.WARN),
  failed = ProtoExpert.new("servotap.failed", "refused or failed", expert.group.RESPONSE_CODE, expert.severity.NOTE),
  junk = ProtoExpert.new("servotap.no_frame", "bytes of no frame", expert.group.MALFORMED, expert.severity.WARN),
}
do
  local all = {}
  for _, each in pairs(own) do all[#all + 1] = each end
  for _, dialect in ipairs(dialects) do
    for _, field in ipairs(dialect.fields) do
      local values = field.type ~= "double" and field.type ~= "bytes" and field.choices or nil
      local shown = field.unit ~= "" and field.name .. " (" .. field.unit .. ")" or field.name
      local numeric = field.type ~= "double" and field.type ~= "bytes"
      field.proto = ProtoField.new(shown, field.path, TYPES[field.type], values, numeric and base.DEC or base.NONE)
      all[#all + 1] = field.proto
    end
  end
  proto.fields = all
  local infos = {}
  for _, each in pairs(expert) do infos[#infos + 1] = each end
  proto.experts = infos
end

-- Fields of other protocols are there at Wireshark's first look at a packet only if a listener filters by them. In two passes
-- tshark has them at the second look, which goes in order too.
local listener = Listener.new("frame", "can.id || frame.interface_id || tcp.stream")
local can_id, can_extended = Field.new("can.id"), Field.new("can.flags.xtd")
local interface, stream = Field.new("frame.interface_id"), Field.new("tcp.stream")

-- Numbers ------------------------------------------------------------------------------------------------------------

local function sum8(bytes, first, last, start)
  local sum = start or 0
  for i = first, last do sum = sum + bytes[i] end
  return sum % 256
end

local function xor(a, b)
  local result, bit = 0, 1
  while a > 0 or b > 0 do
    if a % 2 ~= b % 2 then result = result + bit end
    a, b, bit = math.floor(a / 2), math.floor(b / 2), bit * 2
  end
  return result
end

-- Wireshark has had a library of bits in each version so far; without it the numbers are taken apart.
xor = bit and bit.bxor or bit32 and bit32.bxor or xor

local CRC = {}
for i = 0, 255 do
  local value = i
  for _ = 1, 8 do
    local low = value % 2
    value = math.floor(value / 2)
    if low == 1 then value = xor(value, 0xA001) end
  end
  CRC[i] = value
end

local function crc16(bytes, first, last)
  local crc = 0xFFFF
  for i = first, last do crc = xor(math.floor(crc / 256), CRC[xor(crc % 256, bytes[i])]) end
  return crc
end

local function bytes_of(range)
  local raw, result = range:bytes(), {}
  for i = 0, raw:len() - 1 do result[i + 1] = raw:get_index(i) end
  return result
end

-- The integer as sent of a field; nil beyond 53 bits, which a number of Lua does not hold in every version.
local function wire(bytes, first, field)
  if field.width == 0 or field.width > 53 then return nil end
  local value, low, high = 0, math.floor(field.offset / 8), math.floor((field.offset + field.width - 1) / 8)
  for i = low, high do
    local at = field.little and high - (i - low) or i
    value = value * 256 + bytes[first + at]
  end
  local shift = (high + 1) * 8 - field.offset - field.width
  value = math.floor(value / 2 ^ shift) % 2 ^ field.width
  if field.signed and value >= 2 ^ (field.width - 1) then value = value - 2 ^ field.width end
  return value
end

-- Forms --------------------------------------------------------------------------------------------------------------

local function fits(form, bytes, first, last)
  local size = last - first + 1
  if form.open then
    if size < form.size then return false end
  elseif size ~= form.size then
    return false
  end
  for _, field in ipairs(form.fields) do
    if field.fixed and wire(bytes, first, field) ~= field.fixed then return false end
  end
  return true
end

-- What a field's value breaks: the id of a rule, and its words.
local function broken(dialect, field, value)
  if value == nil then return nil end
  if field.reserved then
    if value ~= 0 then return "reserved_bits", "reserved bits: expected 0, got " .. value end
    return nil
  end
  if field.fixed then return nil end
  local declared = dialect.fields[field.number]
  if declared.choices and not declared.choices[value] or field.listed and not field.listed[value] then
    return "unknown_choice", string.format("%s: got %d, which is not listed", declared.name, value)
  end
  if field.low and value < field.low or field.high and value > field.high then
    local got = string.format("%.9g", value * field.up / field.down)
    return "out_of_range", string.format("%s: got %s, expected %s", declared.name, got, field.range)
  end
  return nil
end

local function in_order(dialect, form, bytes, first)
  for _, field in ipairs(form.fields) do
    if broken(dialect, field, wire(bytes, first, field)) then return false end
  end
  return true
end

-- Commands of a dialect by function and code; a form of another code stands under that.
local function index(dialect, role)
  local result = {}
  for _, command in ipairs(dialect.commands) do
    for _, form in ipairs(command[role]) do
      local key = (command.func or 0) * 65536 + (form.code or command.code)
      result[key] = result[key] or {}
      table.insert(result[key], {command = command, form = form})
    end
  end
  return result
end
for _, dialect in ipairs(dialects) do
  dialect.request, dialect.reply = index(dialect, "request"), index(dialect, "reply")
end

local function entries(dialect, role, head)
  return head.code and dialect[role][(head.func or 0) * 65536 + head.code] or {}
end

local function first_fit(list, bytes, head)
  for _, entry in ipairs(list) do
    if not entry.form.needs and fits(entry.form, bytes, head.first, head.last) then return entry end
  end
  return nil
end

-- Links: where frames end, and what their heads say --------------------------------------------------------------------
-- lengths(dialect, bytes, at, count): lengths that a frame at `at` can have, ascending. head(dialect, bytes, at, length, id).

local links = {}

local function sizes(dialect, role, code)
  local found, seen = {}, {}
  for _, entry in ipairs(dialect[role][code] or {}) do
    if not seen[entry.form.size] then
      seen[entry.form.size] = true
      found[#found + 1] = entry.form.size
    end
  end
  table.sort(found)
  return found
end

links.head = {
  lengths = function(dialect, bytes, at, count)
    local head = bytes[at]
    if dialect.package and head == dialect.package.head then return {dialect.package.length} end
    local role = dialect.heads[head]
    if not role or count < 4 then return {} end
    local result = sizes(dialect, role, bytes[at + 2])
    for i, size in ipairs(result) do result[i] = size + 4 end
    return result
  end,
  head = function(dialect, bytes, at, length)
    local last = at + length - 2
    if dialect.package and bytes[at] == dialect.package.head then
      return {address = 0, role = "request", code = bytes[at], first = at + 1, last = last}
    end
    return {address = bytes[at + 1], role = dialect.heads[bytes[at]], code = bytes[at + 2], first = at + 3, last = last}
  end,
  checks = function(_, bytes, at, length)
    local last = at + length - 1
    return {{at = last, size = 1, expected = sum8(bytes, at, last - 1), got = bytes[last]}}
  end,
}

links.lk = {
  lengths = function(_, bytes, at, count)
    if bytes[at] ~= 0x3E or count < 5 then return {} end
    return {bytes[at + 3] == 0 and 5 or 6 + bytes[at + 3]}
  end,
  head = function(_, bytes, at, length)
    return {address = bytes[at + 2], code = bytes[at + 1], first = at + 5, last = length > 5 and at + length - 2 or at + 4}
  end,
  checks = function(_, bytes, at, length)
    local found = {{at = at + 4, size = 1, expected = sum8(bytes, at, at + 3), got = bytes[at + 4]}}
    if length > 5 then
      local last = at + length - 1
      found[2] = {at = last, size = 1, expected = sum8(bytes, at + 5, last - 1), got = bytes[last]}
    end
    return found
  end,
}

local READS = {[1] = true, [2] = true, [3] = true, [4] = true}
links.modbus = {
  lengths = function(dialect, bytes, at, count)
    local func = bytes[at + 1]
    if count < 4 or bytes[at] > 0xF7 then return {} end
    if func >= 0x81 and func <= 0x90 then return {5} end
    if READS[func] then
      local reply = 5 + bytes[at + 2]
      if reply == 8 then return {8} end
      return reply < 8 and {reply, 8} or {8, reply}
    end
    if func == 5 or func == 6 then return {8} end
    if func == 15 or func == 16 then return count >= 7 and {8, 9 + bytes[at + 6]} or {8} end
    return {}
  end,
  head = function(_, bytes, at, length)
    local func, last = bytes[at + 1], at + length - 3
    local head = {address = bytes[at], func = func, first = at + 2, last = last}
    local register = length >= 6 and bytes[at + 2] * 256 + bytes[at + 3] or nil
    if func >= 0x80 then
      head.func, head.exception, head.role = func - 0x80, bytes[at + 2], "reply"
    elseif READS[func] then
      local is_reply, is_request = length == 5 + bytes[at + 2], length == 8
      if is_reply and not is_request then
        head.role, head.first = "reply", at + 3
      else
        head.code, head.first = register, at + 6
        if not is_reply then head.role = "request" end
      end
    elseif func == 15 or func == 16 then
      head.code = register
      if length == 8 then
        head.role, head.first = "reply", at + 4
      else
        head.role, head.first = "request", at + 7
      end
    else
      head.code, head.first = register, at + 4
    end
    return head
  end,
  checks = function(_, bytes, at, length)
    local last = at + length - 1
    return {{at = last - 1, size = 2, expected = crc16(bytes, at, last - 2), got = bytes[last - 1] + 256 * bytes[last]}}
  end,
}

links.can = {
  head = function(_, bytes, _, length, id)
    return {address = id, code = bytes[1], first = 2, last = math.max(1, length - 1)}
  end,
  checks = function(_, bytes, _, length, id)
    return {{at = length, size = 1, expected = sum8(bytes, 1, length - 1, id), got = bytes[length]}}
  end,
}

local function sound(dialect, bytes, at, length, id)
  for _, check in ipairs(links[dialect.kind].checks(dialect, bytes, at, length, id)) do
    if check.expected ~= check.got then return false end
  end
  return true
end

-- Frames of a serial packet: a list of {at, length}, and how many bytes are in frames whose check fits.
local function cut(dialect, bytes)
  local found, covered, at, count = {}, 0, 1, #bytes
  while at <= count do
    local chosen, left = nil, count - at + 1
    local lengths = links[dialect.kind].lengths(dialect, bytes, at, left)
    for _, length in ipairs(lengths) do
      -- A frame whose check ends in 00 also fits one byte short: the one that ends the packet is meant.
      if length <= left and sound(dialect, bytes, at, length) and (not chosen or length == left) then chosen = length end
    end
    if chosen then
      found[#found + 1] = {at = at, length = chosen}
      covered, at = covered + chosen, at + chosen
    else
      local whole = nil
      for _, length in ipairs(lengths) do if length == left then whole = length end end
      if whole and (dialect.kind ~= "modbus" or #found == 0) then
        found[#found + 1] = {at = at, length = whole}
        at = at + whole
      else
        at = at + 1
      end
    end
  end
  return found, covered
end

-- Which request a reply answers ---------------------------------------------------------------------------------------
-- The rules of `analyzer.context` and `analyzer.transactions`, without their findings: the oldest open request that a reply
-- fits is answered. A reply to a later request ends earlier ones; what was given up may still be answered late.

local GIVE_UP, LATE, ECHO, APART = 5e9, 1e9, 3e6, 20e6  -- in ns
local MOST_OPEN, MOST_GIVEN_UP, MOST_OTHERS = 64, 16, 8

local buses, kept, drives = {}, {}, {}
function proto.init() buses, kept, drives = {}, {}, {} end

local function bus_of()
  local tcp, own_interface = stream(), interface()
  local name = (tcp and "tcp" .. tostring(tcp.value) or "") .. "/" .. (own_interface and tostring(own_interface.value) or "")
  buses[name] = buses[name] or {
    name = name, open = {}, unanswered = {}, superseded = {}, broadcasts = {}, last_reply = {},
    groups = {}, silenced = {}, passive = {}, echoes = 0, count = 0, check = 0,
  }
  return buses[name]
end

local function add(list, item, most)
  table.insert(list, item)
  if #list > most then table.remove(list, 1) end
end

local function drop(list, item)
  for i, each in ipairs(list) do
    if each == item then return table.remove(list, i) end
  end
end

-- The values of a form as sent, by the names of their fields.
local function values_of(dialect, form, bytes, first)
  local result = {}
  for _, field in ipairs(form and form.fields or {}) do
    if field.number then result[dialect.fields[field.number].name] = wire(bytes, first, field) end
  end
  return result
end

-- The form by which a reply answers a request; nil where it does not.
local function answers(request, head, bytes)
  local command = request.command
  if not command or command.func ~= head.func then return nil end
  for _, form in ipairs(command.reply) do
    local ok = (head.code == nil or (form.code or command.code) == head.code) and fits(form, bytes, head.first, head.last)
    for name, value in pairs(form.wanted or {}) do ok = ok and request.values[name] == value end
    if ok then return form end
  end
  return nil
end

local function asked(bus, dialect, head, bytes)
  for _, request in ipairs(bus.open[head.address] or {}) do
    local form = request.dialect == dialect and answers(request, head, bytes)
    if form then return request, form end
  end
  return nil
end

-- The oldest request that waits for a reply of a function, which carries no register.
local function same_function(bus, dialect, head)
  for _, request in ipairs(bus.open[head.address] or {}) do
    if request.state == "waiting" and request.dialect == dialect and request.func == head.func then return request end
  end
  return nil
end

local function same_code(bus, head)
  for _, request in ipairs(bus.open[head.address] or {}) do
    local command = request.command
    if command and command.code == head.code and command.func == head.func then return request end
  end
  return nil
end

local function role_of(bus, dialect, head, bytes)
  if head.code == nil then return same_function(bus, dialect, head) and "reply" or "request" end
  local requests, replies = entries(dialect, "request", head), entries(dialect, "reply", head)
  local request, reply = first_fit(requests, bytes, head), first_fit(replies, bytes, head)
  local answered, form = asked(bus, dialect, head, bytes)
  form = form or reply and reply.form
  if not request and not form then
    if same_code(bus, head) then return "reply" end
    return (#requests > 0 or #replies > 0) and "request" or "unknown"
  end
  if not form then return "request" end
  if not request or form.needs then return "reply" end
  local as_request, as_reply = in_order(dialect, request.form, bytes, head.first), in_order(dialect, form, bytes, head.first)
  if as_request ~= as_reply then return as_request and "request" or "reply" end
  return answered and "reply" or "request"
end

local function finish(bus, request, outcome)
  request.outcome = outcome
  local list = bus.open[request.address]
  if list then
    drop(list, request)
    if #list == 0 then bus.open[request.address] = nil end
  end
end

local function give_up(bus, request, outcome)
  finish(bus, request, outcome or "unanswered")
  add(bus.unanswered, request, MOST_GIVEN_UP)
end

local function each_waiting(bus, chosen, visit)
  local found = {}
  for _, list in pairs(bus.open) do
    for _, request in ipairs(list) do
      if request.state == "waiting" and chosen(request) then found[#found + 1] = request end
    end
  end
  table.sort(found, function(a, b) return a.sequence < b.sequence end)
  for _, request in ipairs(found) do visit(request) end
end

-- What a setting changes in who answers and how.
local function learn(bus, request)
  for effect, name in pairs(request.command and request.command.effects or {}) do
    local value = request.values[name]
    if value and effect == "group" then bus.groups[value] = true end
    if value and effect == "respond" then bus.silenced[request.address] = value == 0 or nil end
    if value and effect == "active" then bus.passive[request.address] = value == 0 or nil end
  end
end

-- The open request that gave the sender of a reply its address.
local function from_new_address(bus, head, bytes)
  local found = nil
  each_waiting(bus, function(request)
    local name = request.command and request.command.effects.address
    return name and request.values[name] == head.address
  end, function(request) found = found or answers(request, head, bytes) and request end)
  return found
end

local function meaning_of(dialect, request, form, values)
  local command = request.command
  if form and form == dialect.exception then return "failed" end
  if not command or not form then return "final" end
  local status = values[command.status]
  if command.failed_forms[form.name] or command.failed[status] then return "failed" end
  return command.interim[status] and "interim" or "final"
end

local function advance(bus, request, frame)
  local meaning = meaning_of(frame.dialect, request, frame.form, frame.values)
  request.state = (meaning == "interim" and not bus.passive[frame.address]) and "running" or "done"
  if meaning == "final" and request.command and request.command.changes then learn(bus, request) end
  bus.last_reply[frame.address] = frame.text
  if request.state == "done" then finish(bus, request, "answered") end
end

-- A reply that no open request asked for: the request that it answers after all; `timed`: its latency says something.
local function unasked(bus, frame, head, bytes)
  for i = #bus.superseded, 1, -1 do
    local request = bus.superseded[i]
    if request.address == frame.address and answers(request, head, bytes) then return table.remove(bus.superseded, i), true end
  end
  for i = #bus.unanswered, 1, -1 do
    local request = bus.unanswered[i]
    if request.address == frame.address and answers(request, head, bytes) then
      table.remove(bus.unanswered, i)
      advance(bus, request, frame)
      return request, true
    end
  end
  for i = #bus.broadcasts, 1, -1 do
    local request = bus.broadcasts[i]
    if frame.time - request.time <= LATE and answers(request, head, bytes) then return request, false end
  end
  bus.last_reply[frame.address] = frame.text
  return nil
end

-- Of equal requests far apart the last is answered by what follows it.
local function nearest(bus, frame, request)
  local last = bus.last_request
  if frame.dialect.kind == "can" or not last or bus.last ~= last or last.outcome or last.text ~= request.text then return request end
  local both_wait = request.state == "waiting" and last.state == "waiting"
  return both_wait and last.time - request.time > APART and last or request
end

local function take_reply(bus, frame, request, head, bytes)
  request = request or from_new_address(bus, head, bytes)
  if not request then return unasked(bus, frame, head, bytes) end
  request = nearest(bus, frame, request)
  if bus.echoes >= 2 and not request.echoed and frame.text == request.text then
    request.echoed = true
    if bus.last == request then
      bus.echoes = bus.echoes + 1
      return nil
    end
  end
  -- A drive answers in order, and on a half-duplex line the host has moved on for all drives.
  each_waiting(bus, function(each)
    return each.sequence < request.sequence and (frame.dialect.kind ~= "can" or each.address == request.address)
  end, function(each) give_up(bus, each) end)
  advance(bus, request, frame)
  return request, true
end

local function repeated(bus, frame)
  local last, request = bus.last, bus.last_request
  if not last or last.text ~= frame.text or last.role == "reply" or not last.sound then return nil end
  if frame.dialect.kind == "can" and last.address ~= frame.address then return nil end
  if not request or request.text ~= frame.text or request.state ~= "waiting" then return nil end
  local silent = request.outcome == "silent"
  if not silent and request.outcome then return nil end
  if silent and frame.time - request.time > ECHO then return nil end
  return request
end

local function take_request(bus, frame)
  local same, command = repeated(bus, frame), frame.command
  if same then
    local gap = frame.time - same.time
    if gap >= 0 and gap <= ECHO then
      bus.echoes = bus.echoes + 1
      return
    end
    give_up(bus, same, "retried")
  end
  local waiting = bus.open[frame.address] or {}
  for i = #waiting, 1, -1 do
    local older = waiting[i]
    if command and command.moves and older.state == "running" then
      finish(bus, older, "superseded")
      add(bus.superseded, older, MOST_OTHERS)
    end
  end
  local to_many = frame.address == frame.dialect.broadcast or bus.groups[frame.address] or command and command.slots
  local silent = command and command.silenced and bus.silenced[frame.address]
  bus.last_request = frame
  if not frame.sound or not command or #command.reply == 0 or to_many or silent then
    frame.outcome = "silent"
    if to_many then
      add(bus.broadcasts, frame, MOST_OTHERS)
      learn(bus, frame)
    end
    return
  end
  waiting = bus.open[frame.address] or {}
  bus.open[frame.address] = waiting
  table.insert(waiting, frame)
  if #waiting > MOST_OPEN then give_up(bus, waiting[1]) end
end

-- The command and form of a frame that fits no form: the length is wrong, or the manual does not have it.
local function unfitting(dialect, result, request, bytes, at)
  local head, role = result.head, result.role == "reply" and "reply" or "request"
  local known = entries(dialect, role, head)
  local general = known[1]
  for i = #known, 1, -1 do
    local fixed = false
    for _, field in ipairs(known[i].form.fields) do fixed = fixed or field.fixed ~= nil end
    if not fixed then general = known[i] end
  end
  result.command = general and general.command or request and request.command
  result.wrong_length, result.unknown = result.command ~= nil, result.command == nil
  local fallback = head.func and dialect.fallbacks[head.func]
  for _, form in ipairs(fallback and (not result.command or role == "reply") and fallback[role] or {}) do
    if not result.form and fits(form, bytes, at + 2, head.last) then
      result.form, head.first, result.command = form, at + 2, result.command or fallback
    end
  end
end

-- Tell who sent a frame, which command it is, and what it answers.
local function judge(dialect, bytes, at, length, id, pinfo)
  local head = links[dialect.kind].head(dialect, bytes, at, length, id)
  local bus, now = bus_of(), math.floor(pinfo.rel_ts * 1e9 + 0.5)
  local result = {head = head, role = head.role or role_of(bus, dialect, head, bytes)}
  local request, form
  if result.role == "reply" then
    if not head.exception then request, form = asked(bus, dialect, head, bytes) end
    if not request then
      if head.code == nil then request = same_function(bus, dialect, head) else request = same_code(bus, head) end
    end
    local entry = not form and head.code and first_fit(entries(dialect, "reply", head), bytes, head)
    if head.exception and dialect.exception then
      result.command, result.form = request and request.command or dialect.fallbacks[head.func], dialect.exception
    elseif form then
      result.command, result.form = request.command, form
    elseif entry then
      result.command, result.form = entry.command, entry.form
    end
  else
    local entry = first_fit(entries(dialect, "request", head), bytes, head)
    if not entry and result.role == "unknown" then entry = first_fit(entries(dialect, "reply", head), bytes, head) end
    if entry then result.command, result.form = entry.command, entry.form end
  end
  if not result.form then unfitting(dialect, result, request, bytes, at) end
  bus.count = bus.count + 1
  local frame = {
    dialect = dialect, address = head.address, func = head.func, role = result.role, command = result.command, form = result.form,
    values = values_of(dialect, result.form, bytes, head.first), text = table.concat(bytes, " ", at, at + length - 1),
    sound = sound(dialect, bytes, at, length, id), time = now, number = pinfo.number, sequence = bus.count, state = "waiting",
    result = result,
  }
  if now >= bus.check then
    bus.check = now + GIVE_UP / 10
    each_waiting(bus, function(each) return now - each.time > GIVE_UP end, function(each) give_up(bus, each) end)
  end
  if result.role == "reply" then
    local answered, timed = take_reply(bus, frame, request, head, bytes)
    if answered then
      result.request_in = answered.number
      if timed and now > answered.time then result.latency = (now - answered.time) / 1e9 end
      answered.result.reply_in = answered.result.reply_in or pinfo.number
    end
  elseif result.role == "request" or result.command then
    take_request(bus, frame)
  end
  bus.last = frame
  return result
end

-- Trees --------------------------------------------------------------------------------------------------------------

-- Add the fields of a form to a tree; return them as words.
local function add_fields(dialect, form, tvb, bytes, first, tree)
  local words = {}
  for _, field in ipairs(form.fields) do
    local low, value = first - 1 + math.floor(field.offset / 8), wire(bytes, first, field)
    local size = math.floor((field.offset % 8 + field.width + 7) / 8)
    local range = field.width == 0 and tvb(low) or tvb(low, size)
    local item
    if field.number then
      local declared = dialect.fields[field.number]
      local text
      if declared.type == "bytes" then
        item, text = tree:add(declared.proto, range), tostring(range:bytes())
      elseif declared.type == "double" then
        local number = value
        if not number then
          local exact = field.signed and (field.little and range:le_int64() or range:int64())
            or (field.little and range:le_uint64() or range:uint64())
          number = exact:tonumber()
        end
        item, text = tree:add(declared.proto, range, number * field.up / field.down), nil
        text = string.format("%.9g", number * field.up / field.down)
      elseif declared.type == "int64" or declared.type == "uint64" then
        item = field.little and tree:add_le(declared.proto, range) or tree:add(declared.proto, range)
        text = value and string.format("%.0f", value) or tostring(field.little and range:le_int64() or range:int64())
      else
        item = tree:add(declared.proto, range, value)
        text = declared.choices and declared.choices[value] or string.format("%.0f", value)
      end
      local unit = declared.unit ~= "" and " " .. declared.unit or ""
      words[#words + 1] = declared.name .. "=" .. text .. unit
    end
    local rule, said = broken(dialect, field, value)
    if rule then (item or tree):add_proto_expert_info(expert[rule], said) end
  end
  return table.concat(words, " ")
end

local function add_slots(dialect, command, tvb, bytes, head, tree)
  local words = {}
  for slot = 0, command.slots.count - 1 do
    local at = head.first + slot * command.slots.size
    local used = false
    for i = at, math.min(at + command.slots.size - 1, head.last) do used = used or bytes[i] ~= 0 end
    if used and at + 1 <= head.last then
      local branch = tree:add(own.raw_data, tvb(at - 1, math.min(command.slots.size, head.last - at + 1)))
      branch:add(own.address, tvb(at - 1, 1))
      for _, entry in ipairs(dialect.request[bytes[at + 1]] or {}) do
        local last = at + 1 + entry.form.size
        if last <= head.last and fits(entry.form, bytes, at + 2, last) then
          branch:add(own.command, tvb(at, 1), entry.command.name)
          local text = add_fields(dialect, entry.form, tvb, bytes, at + 2, branch)
          words[#words + 1] = string.format("%d %s %s", bytes[at], entry.command.name, text)
          break
        end
      end
    end
  end
  return table.concat(words, "; ")
end

-- Add one frame to the tree; return its line for the Info column.
local function show(dialect, tvb, bytes, at, length, id, tree, result)
  local head, command, range = result.head, result.command, tvb(at - 1, length)
  local branch = tree:add(proto, range)
  branch:add(own.dialect, range, dialect.name)
  branch:add(own.frame, range)
  branch:add(own.address, range, head.address):set_generated()
  branch:add(own.role, range, result.role):set_generated()
  local name = command and command.name or "unknown"
  branch:add(own.command, range, name)
  local words = ""
  if result.form and command and command.slots then
    words = add_slots(dialect, command, tvb, bytes, head, branch)
  elseif result.form then
    words = add_fields(dialect, result.form, tvb, bytes, head.first, branch)
  elseif head.last >= head.first then
    branch:add(own.raw_data, tvb(head.first - 1, head.last - head.first + 1))
  end
  if result.wrong_length then
    branch:add_proto_expert_info(expert.wrong_length, string.format("%s: %d bytes of data", name, head.last - head.first + 1))
  elseif not command or result.unknown then
    branch:add_proto_expert_info(expert.unknown_command)
  end
  local right = true
  for _, check in ipairs(links[dialect.kind].checks(dialect, bytes, at, length, id)) do
    local item = branch:add(own.checksum, tvb(check.at - 1, check.size))
    if check.expected ~= check.got then
      right = false
      local format = check.size == 2 and "checksum: expected %04X, got %04X (low byte first)" or "checksum: expected %02X, got %02X"
      item:add_proto_expert_info(expert.checksum, string.format(format, check.expected, check.got))
    end
  end
  branch:add(own.checksum_ok, range, right):set_generated()
  if command then
    local failed = result.role == "reply" and result.form and command.failed_forms[result.form.name]
    for _, field in ipairs(result.role == "reply" and result.form and result.form.fields or {}) do
      local declared = field.number and dialect.fields[field.number]
      failed = failed or declared and declared.name == command.status and command.failed[wire(bytes, head.first, field)]
    end
    if failed then branch:add_proto_expert_info(expert.failed) end
    branch:add(own.section, range, command.section .. ": " .. command.summary):set_generated()
    for _, erratum in ipairs(command.errata) do branch:add(own.erratum, range, erratum):set_generated() end
  end
  if result.request_in then branch:add(own.request_in, range, result.request_in):set_generated() end
  if result.latency then branch:add(own.latency, range, result.latency):set_generated() end
  if result.reply_in then branch:add(own.reply_in, range, result.reply_in):set_generated() end
  local latency = result.latency and string.format("  (%.3f ms)", result.latency * 1000) or ""
  local line = string.format("%d %s %s %s%s%s", head.address, result.role, name, words, right and "" or " [wrong checksum]", latency)
  branch:append_text(": " .. line)
  return line
end

-- A packet is judged when it comes first, in the order of the capture; later looks at it see the same.
local function place_of(tvb, pinfo) return pinfo.number .. "/" .. tvb:offset() end

local function show_all(dialect, tvb, pinfo, tree, bytes, frames, id)
  local place, lines, covered = place_of(tvb, pinfo), {}, 0
  if not kept[place] then
    local results = {}
    kept[place] = {dialect = dialect, frames = frames, results = results}
    for i, frame in ipairs(frames) do results[i] = judge(dialect, bytes, frame.at, frame.length, id, pinfo) end
  end
  for i, frame in ipairs(frames) do
    if frame.at - 1 > covered then
      tree:add(own.junk, tvb(covered, frame.at - 1 - covered)):add_proto_expert_info(expert.junk)
    end
    lines[#lines + 1] = show(dialect, tvb, bytes, frame.at, frame.length, id, tree, kept[place].results[i])
    covered = frame.at - 1 + frame.length
  end
  if covered < #bytes then
    tree:add(own.junk, tvb(covered)):add_proto_expert_info(expert.junk, "bytes of no frame, or of one that other packets go on with")
  end
  pinfo.cols.protocol:set(dialect.name)
  pinfo.cols.info:set(table.concat(lines, " | "))
end

-- Where packets come from ----------------------------------------------------------------------------------------------

local function by_kind(kind)
  for _, dialect in ipairs(dialects) do
    if dialect.kind == kind then return dialect end
  end
  return nil
end

local function on_can(tvb, pinfo, tree, sure)
  local dialect, id, extended = by_kind("can"), can_id(), can_extended()
  if not dialect or not id or extended and extended.value or tvb:len() < 2 or tvb:len() > 8 then return 0 end
  local address, bytes = id.value, bytes_of(tvb())
  local key = bus_of().name .. "/" .. address
  local right = sound(dialect, bytes, 1, #bytes, address)
  local head = links.can.head(dialect, bytes, 1, #bytes, address)
  local known = #entries(dialect, "request", head) > 0 or #entries(dialect, "reply", head) > 0
  if right and known then drives[key] = true end
  local place = place_of(tvb, pinfo)
  if not kept[place] and not (sure or right and known or drives[key]) then kept[place] = {} end
  if kept[place] and not kept[place].dialect then return 0 end
  show_all(dialect, tvb, pinfo, tree, bytes, {{at = 1, length = #bytes}}, address)
  return tvb:len()
end

local function on_serial(tvb, pinfo, tree)
  local bytes, bus, before = bytes_of(tvb()), bus_of(), kept[place_of(tvb, pinfo)]
  if before then
    if not before.dialect then return 0 end
    show_all(before.dialect, tvb, pinfo, tree, bytes, before.frames)
    return tvb:len()
  end
  local best, best_frames, most = nil, nil, 0
  for _, dialect in ipairs(dialects) do
    local said = proto.prefs.dialect == dialect.name
    if dialect.kind ~= "can" and (said or proto.prefs.dialect == "auto") then
      local frames, covered = cut(dialect, bytes)
      local expected = said or dialect == bus.dialect
      -- Where two fit alike, the dialect that the bus spoke before.
      if covered > most or covered == most and covered > 0 and expected then
        best, best_frames, most = dialect, frames, covered
      elseif not best and expected and #frames > 0 then
        best, best_frames = dialect, frames
      end
    end
  end
  if not best then
    kept[place_of(tvb, pinfo)] = {}
    return 0
  end
  bus.dialect = best
  show_all(best, tvb, pinfo, tree, bytes, best_frames)
  return tvb:len()
end

function proto.dissector(tvb, pinfo, tree)
  if tvb:len() == 0 then return 0 end
  if can_id() then return on_can(tvb, pinfo, tree, true) end
  return on_serial(tvb, pinfo, tree)
end

proto:register_heuristic("can", function(tvb, pinfo, tree) return on_can(tvb, pinfo, tree, false) > 0 end)
for _, name in ipairs({"can.subdissector", "rtacser.data", "tcp.port", "udp.port"}) do
  pcall(function() DissectorTable.get(name):add_for_decode_as(proto) end)
end
