/* The protocol of intent, effect and outcome between a daemon, its journal, a robot controller and an instrument, as
 * docs/model/journal.md maps it to the source. Checked by `make model`: every order of all steps below, with FAULTS of
 * any kind (the daemon killed, its computer's power cut, the controller rebooted) between any two of them.
 *
 * Each of these breaks it, and Spin must find how: EARLY_ACK, LATE_INTENT, NO_MARK, SAME_CYCLE, ANY_MAP, BLIND_MEMORY.
 */
#ifndef FAULTS
#define FAULTS 3
#endif
#define PASSES 2                    /* whole ones; then the job is over */
#define CYCLES (PASSES + FAULTS)    /* each fault costs a pass at most */
#define BLOCKS 2                    /* of one program */

#define UNDER_WAY 0
#define DONE 1
#define INTERRUPTED 2

typedef Journal {
    byte begun;                     /* passes: intent is in the journal; their numbers are 0 to begun - 1 */
    byte boot[CYCLES];              /* which run of the controller was asked */
    byte recorded[CYCLES];          /* blocks below it are recorded as executed */
    byte uncertain[CYCLES];         /* blocks below it may have been executed */
    byte how[CYCLES];
    byte map                        /* the last one that was taken */
}
Journal cache, disk;                /* what a killed process leaves, and what a power cut leaves */

/* what the journal has confirmed as durable */
byte durable_begun, durable_map;
byte durable_recorded[CYCLES];

/* the robot controller */
byte boot = 1;
byte program;                       /* 0: none; else the cycle that it is of, and 1 */
byte executed;                      /* its blocks below it */
bool runs;

/* the part, and the instrument: a map shows all that was polished when it was measured */
byte polished;
bool touched[CYCLES * BLOCKS];
byte map = 0;
byte shows;
byte asked;                         /* the map that is waited for; kept beside the journal, as its map is */

bool alive, finished;
bool killed;
byte faults = FAULTS;

inline copy(from, to) {
    d_step {
        to.begun = from.begun; to.map = from.map;
        for (k : 0 .. CYCLES - 1) {
            to.boot[k] = from.boot[k]; to.recorded[k] = from.recorded[k];
            to.uncertain[k] = from.uncertain[k]; to.how[k] = from.how[k]
        }
        k = 0
    }
}

/* After the rows are in the WAL: fdatasync, and the method returns. Between any two steps all may end. */
inline durable() {
#ifndef EARLY_ACK
    copy(cache, disk);
#endif
    d_step {
        durable_begun = cache.begun; durable_map = cache.map;
        for (k : 0 .. CYCLES - 1) { durable_recorded[k] = cache.recorded[k] }
        k = 0
    }
}

/* Nothing that was confirmed is gone. */
inline require_kept() {
    d_step {
        assert(cache.begun >= durable_begun && cache.map >= durable_map);
        for (k : 0 .. CYCLES - 1) { assert(cache.recorded[k] >= durable_recorded[k]) }
        k = 0
    }
}

/* Whatever was polished has a mark, now that the journal believes to know. */
inline require_marked() {
    d_step {
        for (k : 0 .. CYCLES * BLOCKS - 1) {
            assert(!touched[k] || (k / BLOCKS < cache.begun && (k % BLOCKS < cache.recorded[k / BLOCKS] ||
                                                               k % BLOCKS < cache.uncertain[k / BLOCKS])))
        }
        k = 0
    }
}

inline intent() {
    d_step { cache.boot[cycle] = boot; cache.begun = cycle + 1 }
    durable()
}

proctype Daemon() {
    byte cycle, k, heard, whole;
    byte seen, based;               /* the map that the plan rests on, and what it shows */

starts:                             /* an operator types `polishd run` */
    alive = true;
    {
        require_kept();
        runs = false;               /* all devices are made safe, and confirm it: a robot that runs is `busy` until then */
        whole = 0; cycle = 0; heard = 0; based = 0; seen = 0;
        if
        :: cache.begun > 0 && cache.how[cache.begun - 1] == UNDER_WAY ->
            cycle = cache.begun - 1;
            if                      /* what it remembers, by one STATUS */
#ifdef BLIND_MEMORY
            :: atomic { program == cycle + 1 || boot != cache.boot[cycle] -> heard = executed };
#else
            :: atomic { program == cycle + 1 && boot == cache.boot[cycle] -> heard = executed };
#endif
                d_step {
                    cache.recorded[cycle] = heard;
#ifndef NO_MARK
                    cache.uncertain[cycle] = (heard < BLOCKS -> heard + 1 : BLOCKS)
#endif
                };
                durable()
            :: else ->
#ifndef NO_MARK
                cache.uncertain[cycle] = BLOCKS;
#endif
                durable()
            fi;
            cache.how[cycle] = INTERRUPTED;
            durable();
            cycle = 0
        :: else
        fi;
        /* held: nothing moves until a person says `resume` */
cycles:
        require_marked();
        cycle = cache.begun;
#ifdef SAME_CYCLE
        if
        :: cycle > 0 && cache.how[cycle - 1] == INTERRUPTED -> cycle--
        :: else
        fi;
#endif
        /* measure: one map that was asked for after the last one was taken */
        if
        :: asked <= cache.map -> asked = map + 1    /* else it is the same ask */
        :: else
        fi;
#ifdef ANY_MAP
        (map > 0);
#else
        (map >= asked);
#endif
        d_step { seen = map; based = shows };
        cache.map = seen;
        durable();
        /* in tolerance: so many whole passes */
        d_step {
            whole = 0;
            for (k : 0 .. CYCLES - 1) { whole = whole + (cache.how[k] == DONE) }
            k = 0
        };
        if
        :: whole >= PASSES -> finished = true; goto over
        :: else
        fi;
        assert(cycle < CYCLES);
        d_step { program = cycle + 1; executed = 0; heard = 0 };       /* LOAD: forgets what was there */
        assert(based == polished);                                     /* the plan is of the part as it is */
#ifndef LATE_INTENT
        intent();
#endif
        if
        :: atomic { program == cycle + 1 -> runs = true }              /* RESUME */
        :: program != cycle + 1 -> goto ends
        fi;
#ifdef LATE_INTENT
        intent();
#endif
        do
        :: heard < executed && program == cycle + 1 -> heard++         /* EXECUTED, into the buffer */
        :: heard > cache.recorded[cycle] ->                            /* the group's commit */
            cache.recorded[cycle] = heard;
            durable()
        :: heard == BLOCKS && cache.recorded[cycle] == BLOCKS ->
            cache.how[cycle] = DONE;
            durable();
            goto cycles
        :: program != cycle + 1 -> goto ends                           /* it has booted: the link is lost */
        od;
ends:
        skip                                                           /* an error ends the daemon */
    } unless { killed };
    alive = false;
    killed = false;
    goto starts;
over:
    alive = false
}

proctype Robot() {
    byte at;
    do
    :: atomic { runs && program > 0 && executed < BLOCKS ->
            at = (program - 1) * BLOCKS + executed;
            assert(!touched[at]);                                      /* no block is ever run twice */
            touched[at] = true;
            polished++
        };
        if                                                             /* a block under way is polished, not executed */
        :: atomic { program > 0 && at == (program - 1) * BLOCKS + executed ->
                executed++;
                if
                :: executed == BLOCKS -> runs = false
                :: else
                fi
            }
        :: program == 0 || at != (program - 1) * BLOCKS + executed     /* it booted, or was given another program */
        :: !runs                                                       /* it was stopped amid the block */
        fi
    :: atomic { runs && !alive -> runs = false }                       /* its watchdog */
    :: finished -> break
    od
}

proctype Instrument() {
end:
    do
    :: atomic { map < asked && !runs -> map++; shows = polished }
    :: finished -> break
    od
}

proctype Faults() {
    byte k;
    do
    :: atomic { faults > 0 && alive && !killed -> faults--; killed = true }
    :: atomic { faults > 0 && alive && !killed -> faults--; copy(disk, cache); killed = true }    /* power */
    :: atomic { faults > 0 -> faults--; boot++; program = 0; executed = 0; runs = false }
    :: faults == 0 || finished -> break
    od
}

init {
    atomic { run Daemon(); run Robot(); run Instrument(); run Faults() }
}

/* Faults come to an end, and then so does the job. */
ltl goes_on { <> finished }
