/* Rejoin: after a stop or a power cut a robot moves only when a person has reset it, if it was latched,
 * has started it since, and when it has asked the fleet what holds it.
 *
 * One robot, and a fleet that presses and is released; CRASHES power cuts at any moment. Durable are
 * the stop, its clearance, and `hold`: what a person has still to do at this machine.
 *
 * No variant      as agent/safety.py does it                                 holds
 * HOLD_LOST       `hold` is not remembered: a restart is a reset and a start   fails (found in our code)
 * RESET_STARTS    a reset is remembered as nothing left to do                fails
 * NO_EXCHANGE     moves before beats went to and fro                         fails
 * REACH           works after a stop, a power cut, a reset and a start       is found
 */
#ifndef CRASHES
#define CRASHES 3
#endif
#define PRESSES 2
mtype = { OFF, DISCONNECTED, IDLE, WORKING, STOPPED };
mtype = { FREE, HELD, LATCHED };

mtype state = DISCONNECTED, hold = FREE;
bool knows, started = true, exchanged;   /* knows: durable, a stop that is not cleared */
bool fleet;                              /* the others hold a stop that is not cleared */
byte crashes, presses;
bool must_reset, must_start;             /* ghosts: what a person owes this machine */

#define ON (state != OFF)
inline latch() { state = STOPPED; hold = LATCHED; knows = true; must_reset = true; must_start = true }

active proctype Robot() {
  do
  :: atomic { state == DISCONNECTED -> state = IDLE; exchanged = false }
  :: atomic { state == IDLE || state == WORKING ->      /* beats: a latched fleet tells who is not */
       exchanged = true;
       if :: fleet -> latch() :: else fi }
#ifdef NO_EXCHANGE
  :: atomic { state == IDLE && started -> state = WORKING;
#else
  :: atomic { state == IDLE && started && exchanged -> state = WORKING;
#endif
#ifdef REACH
       assert(!(presses && crashes))
#else
       assert(!must_reset && !must_start); assert(exchanged || !fleet)
#endif
     }
  :: atomic { state == WORKING -> state = IDLE }
  :: atomic { ON && crashes < CRASHES -> crashes++; state = OFF; started = false; exchanged = false }
  :: atomic { state == OFF ->
#ifdef HOLD_LOST
       hold = (knows -> LATCHED : FREE);
#endif
       state = (hold == LATCHED -> STOPPED : DISCONNECTED); started = (hold == FREE) }
  od
}

active proctype World() {
  do
  :: atomic { presses < PRESSES -> presses++; fleet = true;
       if :: ON -> latch() :: skip fi }                 /* heard, or not: off, cut, lost */
  :: atomic { fleet -> fleet = false; if :: knows = false :: skip fi }   /* cleared; heard, or not */
  :: atomic { !fleet && knows -> knows = false }        /* ... and told later */
  :: atomic { state == STOPPED && !knows ->             /* a person resets this machine */
       state = DISCONNECTED; started = false; must_reset = false;
#ifdef RESET_STARTS
       hold = FREE
#else
       hold = HELD
#endif
     }
  :: atomic { ON && hold != LATCHED && !started -> started = true; hold = FREE; must_start = false }
  od
}
