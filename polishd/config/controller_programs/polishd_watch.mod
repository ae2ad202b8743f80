MODULE polishd_watch
  ! polishd's background task (docs/protocols/abb_rws.md): it stops the robot's motion when polishd's heartbeat stops.
  ! Install it as a task of type SEMISTATIC with trust level SysHalt, named T_POLISHD, entry main.
  ! polishd counts polishd_heart up; polishd_limit is the longest silence in seconds, and 0 switches the watch off.
  PERS num polishd_heart:=0;
  PERS num polishd_limit:=0;
  ! polishd sets polishd_clear to 1 to allow motion again; the task does so only while no program runs.
  PERS num polishd_clear:=0;
  ! Seconds that the motion task was stopped since its program began.
  PERS num polishd_stood:=0;
  ! The last heartbeat seen; 1 after the motion was stopped; the limit in force.
  PERS pos polishd_state:=[0,0,0];
  VAR clock polishd_silent;
  VAR clock polishd_turn;

  PROC main()
    VAR num heart:=0;
    VAR num tripped:=0;
    ClkReset polishd_silent;
    ClkStart polishd_silent;
    ClkReset polishd_turn;
    ClkStart polishd_turn;
    WHILE TRUE DO
      IF polishd_heart<>heart OR polishd_limit=0 THEN
        heart:=polishd_heart;
        ClkReset polishd_silent;
        ClkStart polishd_silent;
      ENDIF
      IF TaskRunRob() THEN
        IF tripped=0 AND polishd_limit>0 AND ClkRead(polishd_silent)>polishd_limit THEN
          StopMove\AllMotionTasks;
          tripped:=1;
        ENDIF
      ELSE
        polishd_stood:=polishd_stood+ClkRead(polishd_turn);
        IF tripped=1 AND polishd_clear=1 THEN
          StartMove\AllMotionTasks;
          tripped:=0;
        ENDIF
      ENDIF
      ClkReset polishd_turn;
      ClkStart polishd_turn;
      polishd_state:=[heart,tripped,polishd_limit];
      WaitTime 0.02;
    ENDWHILE
  ENDPROC
ENDMODULE
