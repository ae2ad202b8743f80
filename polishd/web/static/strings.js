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

  // cell

  // queue

  // history

  // host
};
