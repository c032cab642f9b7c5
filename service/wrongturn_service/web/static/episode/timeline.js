// Arithmetic of the replay. A position counts decisions, which are 0.1 s apart; between two of them it is a fraction.

export const STEP = 0.1;
export const SHEET = 20;

const COMMANDS = new Map([[-1, "nothing"], [1, "left"], [2, "right"], [3, "straight on"], [4, "follow the lane"]]);

/** Return a command's name. */
export function commandName(command) {
  return COMMANDS.get(command) ?? "unknown";
}

/** Return a position that is not before the start or after the last of `count` decisions. */
export function within(position, count) {
  return Math.min(Math.max(position, 0), count - 1);
}

/** Return the decision that a drive shows at a position; after its end, its last one. */
export function decisionAt(drive, position) {
  return Math.floor(within(position, drive.t.length) + 1e-9);
}

/** Return the car's place at a position, between two decisions on the way from one to the other. */
export function poseAt(drive, position) {
  const a = decisionAt(drive, position);
  const b = Math.min(a + 1, drive.t.length - 1);
  const share = within(position, drive.t.length) - a;
  const turn = Math.atan2(Math.sin(drive.yaw[b] - drive.yaw[a]), Math.cos(drive.yaw[b] - drive.yaw[a]));
  return {
    x: drive.x[a] + share * (drive.x[b] - drive.x[a]),
    y: drive.y[a] + share * (drive.y[b] - drive.y[a]),
    yaw: drive.yaw[a] + share * turn,
  };
}

/** Return the sheet of the camera's pictures that has a decision, and the decision's place in it. */
export function sheetOf(decision) {
  return { sheet: Math.floor(decision / SHEET), row: decision % SHEET };
}

/** Return what a drive shows at a decision, in words. */
export function said(drive, decision) {
  const brake = drive.brake[decision];
  const throttle = drive.throttle[decision];
  const steer = drive.steer[decision];
  const percent = (value) => `${Math.round(100 * value)} %`;
  return {
    speed: `${(3.6 * drive.v[decision]).toFixed(1)} km/h`,
    command: commandName(drive.command[decision]),
    route: commandName(drive.route_command[decision]),
    steer: Math.abs(steer) < 0.005 ? "straight" : `${percent(Math.abs(steer))} ${steer < 0 ? "left" : "right"}`,
    pedal: brake > 0 ? `brake ${percent(brake)}` : throttle > 0 ? `gas ${percent(throttle)}` : "none",
  };
}

/** Return seconds as people read them. */
export function seconds(time) {
  return `${time.toFixed(1)} s`;
}

/** Return the moments that a replay passes on its way from one position to a later one. */
export function passed(moments, from, to) {
  return moments.filter(({ decision }) => decision > from && decision <= to);
}

/** Return the seconds in an address's fragment, `#t=6.0`; null if it has none. */
export function timeIn(fragment) {
  const found = /^#t=(\d+(?:\.\d+)?)$/.exec(fragment);
  return found && Number(found[1]);
}
