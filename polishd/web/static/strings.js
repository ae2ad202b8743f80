// All English texts of the page, by view. Another language is another file of these names.
export const texts = {
  // the shell
  skip: "To the content", token: "Your token", signIn: "Sign in", signOut: "Sign out", signInTo: "Polishing cell",
  tokenFrom: "A token is made with: polishd web CELL.toml --add-user NAME --role ROLE",
  tabs: { dashboard: "Dashboard", maps: "Maps", cell: "Cell", queue: "Queue", history: "History", host: "Host" },
  settings: "Settings", theme: "Colours", themes: { auto: "System", light: "Light", dark: "Dark" },
  sound: "Alarm sound", sounds: { on: "On", off: "Off" }, soundTest: "Test the sound", silence: "Silence", soundBlocked: "The browser plays no sound before you click on the page once.",
  soundPlayed: "Three tones were played. Heard nothing? Check the volume of this device.",
  hold: "Hold", stop: "Stop", resume: "Resume", approve: "Approve plan", acknowledge: "Acknowledge", show: "Show",
  reason: "Reason (is journalled)", noEstop: "Hold and Stop are not an emergency stop. In danger press the emergency stop at the machine.",
  cancel: "Cancel",
  stopAsk: ["End the run too?", "The cell was ordered to hold: the tool leaves the part now.",
    "End the run: the daemon ends. It must be started again at the computer of the cell (polishd run).",
    "Stay held: the job goes on after Resume."],
  stopHeld: ["End the run?", "The cell is not in contact. The daemon ends, and must be started again at the computer of the cell (polishd run)."],
  stopYes: "End the run", stopNo: "Stay held",
  resumeAsk: ["Resume?", "The robot moves, and the cell goes on without another question.", "Check that no person is in the cell."],
  wrongToken: "This token is not valid.", locked: "Too many wrong tokens: wait a minute.",
  lostPage: "No connection to the page's server. What is shown is from before.",
  lostDaemon: "NO DAEMON RUNS. What is shown is from before. Go to the cell.",
  silentDaemon: "The daemon does not answer. What is shown is from before. Hold and Stop are still tried.",
  sent: "sent", obeyed: "obeyed", notYet: "given; not obeyed yet", refused: "refused",
  moreAlarms: (count) => (count > 0 ? ` (and ${count} more)` : ""),
  lastOrder: (order, by, at) => `Last order: ${order} by ${by}, ${at}`,
  byUnknown: "an unnamed client",
  noView: "This view is not part of this version of the page.",
  age: (s) => (s === null || s === undefined ? "no data yet" : s < 1.5 ? "live" : s < 60 ? `${Math.round(s)} s old` : `${Math.round(s / 60)} min old`),
  states: { starting: "Starting", idle: "Ready", changing: "Part change", polishing: "Working", held: "Held", finished: "Finished" },
  approval: "Waits for approval", attention: "needs you",

  // dashboard

  // maps
  maps: {
    look: "View", show: "Show", flat: "2-D map", solid: "3-D surface", pass: "Measurement", colours: "Colours", ends: "Colours end at", outside: "Outside the clear aperture",
    kinds: { measured: "Measured", predicted: "Predicted", residual: "Residual", removal: "Removal", dwell: "Dwell", gamma: "Gamma" },
    about: {
      measured: "Heights that the instrument measured, mean removed.", predicted: "Surface that the plan of this pass expects.",
      residual: "Next measurement less the plan's prediction.", removal: "Removal that the plan of this pass expects.",
      dwell: "Dwell time of the nearest point of the path.", gamma: "Depth ratio at the nearest point of the path: 1 is a rigid robot.",
    },
    tables: { auto: "As in the reports", diverging: "Blue, white, red", cividis: "Cividis", viridis: "Viridis", gray: "Gray" },
    scales: { auto: "99.5 % of the values", full: "Least and greatest", first: "As the first measurement" },
    hide: { dim: "Pale", hide: "Hidden", show: "Full colour" },
    path: "Path of the tool", smooth: "Interpolate between samples", outline: "Edge of the clear aperture",
    zoomIn: "Zoom in", zoomOut: "Zoom out", whole: "Show all", figures: "In the clear aperture",
    names: { pv: "PV", rms: "RMS", low: "Least", high: "Greatest", mean: "Mean", pitch: "Sample pitch", size: "Samples" },
    cycle: (number, rms) => `${number}: ${rms}`, first: "before polishing", after: (number) => `after pass ${number}`,
    noJob: "There is no measurement yet.", none: "There is no such map", noData: "no data here", beyond: "outside the clear aperture",
    oldPlan: "The daemon keeps the plan of a job until the next job begins.",
    canvas: (kind, unit) => `Map, ${kind}${unit ? `, ${unit}` : ""}. Arrow keys move the cursor, with Shift ten samples. Plus, minus: zoom. 0: all.`,
    solidCanvas: (kind) => `Surface, ${kind}. Arrow keys turn it, with Shift they shift it. Plus, minus: zoom. 0: from the start.`,
    profile: (axis, other, at) => `Profile along ${axis} at ${other} = ${at} mm`,
    keys: "Move over the map, tap it or use the arrow keys to read it. Wheel, pinch, + and − zoom; drag a zoomed map.",
    solidKeys: "Drag or arrow keys turn the surface; with Shift they shift it. Wheel, pinch, + and − zoom; 0 starts again.",
    height: "Vertical exaggeration", times: (value) => `${value} ×`, relief: (value) => `${value} of the start`,
    noWebgl: "This browser has no WebGL 2, which the 3-D surface needs. The 2-D map shows the same data.",
  },

  // cell
  cellView: {
    canvas: "Robot, part and path. Arrow keys turn the view, with Shift they shift it. Plus, minus: zoom. 0: from the start.",
    views: { free: "Free", top: "Top", side: "Side", front: "Front" }, view: "View", focus: "Centre", focuses: { cell: "Whole cell", part: "Part" }, pass: "Pass", follow: "Follow the tool", point: "Point of the path",
    colour: "Dwell per point", block: "Block", tip: "Tip, base frame", shown: "Shown", state: "Contact", robot: "Robot",
    robots: { hybrid: "hybrid, 3 UPS and UP with C/A wrist", serial: "six-axis arm", measured: "measured compliance, no kinematics" },
    on: "tool on the part", off: "tool off the part", notRunning: "no pass runs", noPlan: "There is no plan yet.",
    nominal: "Stick figure from the cell's kinematics, at nominal poses: the calibrated seat of the part and the tool's deflection are not in it.",
    keys: "Drag or arrow keys turn the view; with Shift they shift it. Wheel, pinch, + and − zoom; 0 starts again.",
  },

  // queue

  // history

  // host
};
