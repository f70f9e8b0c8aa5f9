/* Stop: who has held a stop stands until an operator has named that very stop, whatever is lost.
 *
 * Three robots; PRESSES presses, RESETS resets, CRASHES power cuts with a restart. What was said is a
 * set from which anybody may hear anything at any later time, again, or never: that contains loss,
 * omission, cuts and late frames. An event and its record are one step (tests/agent/test_sqlite_journal
 * and tests/sim/test_disk look inside of that step).
 *
 * No variant                        dots, observed-remove reset, durable records     holds
 * AMNESIA                           a power cut loses stops, clearances and counter  fails: a dot is used
 *                                                                                    twice
 * AMNESIA FRESH_DOTS                the same, under a new incarnation                fails: a stop nobody
 *                                                                                    else heard is forgotten
 * AMNESIA FRESH_DOTS BOOT_LATCHED   and stands after it until a person has come      fails: nobody can
 *                                                                                    name what is forgotten
 * REACH                           somebody is stopped and released                   is found
 *
 * BOOT_LATCHED is what a robot without memory does, because nothing better is possible: that person answers
 * for it. docs/how/safety_case.md says so.
 */
#define N 3
#ifndef PRESSES
#define PRESSES 2
#endif
#ifndef RESETS
#define RESETS 2
#endif
#ifndef CRASHES
#define CRASHES 1
#endif
#define DOTS (N * PRESSES)
#define DOT(r, n) (1 << ((r) * PRESSES + (n) - 1))
#define OPEN(r) (held[r] & ~cleared[r])

short held[N], cleared[N];  /* the stop set of each robot */
byte counter[N];            /* of own presses */
bool latched[N];            /* left by a manual reset only */
short said, released;       /* stops and clearances that were on the bus */
byte presses, resets, crashes;
short ever[N], named;       /* ghosts: what a robot has ever held, what an operator has named */

/* any bit of `from`, or none */
inline any(from, d, k) {
  d = 0; k = 0;
  do
  :: k < DOTS && (from & (1 << k)) -> d = 1 << k; break
  :: k < DOTS -> k++
  :: k == DOTS -> break
  od;
  k = 0
}

proctype Robot(byte me) {
  short d; byte k;
  do
  :: atomic { presses < PRESSES ->
       presses++; counter[me]++; d = DOT(me, counter[me]);
       held[me] = held[me] | d; ever[me] = ever[me] | d; said = said | d; latched[me] = true; d = 0 }
  :: atomic { (said & ~held[me]) != 0 -> any(said & ~held[me], d, k);
       if
       :: d != 0 && (cleared[me] & d) == 0 ->
            held[me] = held[me] | d; ever[me] = ever[me] | d; latched[me] = true
       :: else
       fi; d = 0 }
  :: atomic { (released & ~cleared[me]) != 0 -> any(released & ~cleared[me], d, k);
       cleared[me] = cleared[me] | d; d = 0 }
  :: atomic { latched[me] && OPEN(me) == 0 -> latched[me] = false;  /* a person at this machine */
#ifdef REACH
       assert(ever[me] == 0)
#endif
     }
  :: atomic { crashes < CRASHES -> crashes++;
#ifdef AMNESIA
       held[me] = 0; cleared[me] = 0; latched[me] = false;
#ifndef FRESH_DOTS
       counter[me] = 0;
#endif
#ifdef BOOT_LATCHED
       latched[me] = true
#endif
#endif
     }
  od
}

/* Names what some robot shows, perhaps long after it was shown. */
proctype Operator() {
  short shown;
  do
  :: atomic { resets < RESETS && shown == 0 ->
       if :: shown = OPEN(0) :: shown = OPEN(1) :: shown = OPEN(2) fi }
  :: atomic { shown != 0 -> resets++; named = named | shown; released = released | shown; shown = 0 }
  od
}

#define SAFE(r) (latched[r] || (ever[r] & ~named) == 0)
proctype Judge() {
  atomic { !(SAFE(0) && SAFE(1) && SAFE(2)) -> assert(false) }
}

init { atomic { run Robot(0); run Robot(1); run Robot(2); run Operator(); run Judge() } }
